//#if LIVE
@group(0) @binding(7) var<storage, read> live: array<u32>;             // how many rows count, and which
fn rows() -> u32 { return live[0]; }
fn row_at(i: u32) -> u32 { return live[1u + i]; }
//#else
fn rows() -> u32 { return p.m; }
fn row_at(i: u32) -> u32 { return i; }
//#end
var<private> row_count: u32;
