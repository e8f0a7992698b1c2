// The operands of a product, in fours: all sizes and strides are multiples of 4, and what pads them is 0.
struct Product {
    m: u32, n: u32,             // rows and columns of C
    k1: u32, k2: u32,           // columns of A1 and A2
    lda1: u32, lda2: u32,       // numbers between their rows
    every2: u32,                // rows that share a row of A2
    ldw: u32, w_from: u32,
    ldc: u32, c_from: u32,
    relu: u32,
    ldx: u32,
    part_rows: u32,             // rows of a part of a gradient
    parts: u32,                 // number of such parts
    parameters: u32,            // numbers of a part
    to: u32,                    // the layer's first number in it
}
@group(0) @binding(0) var<uniform> p: Product;
// Each matrix is kept as Full or as Half.
alias Full = vec4<f32>;
fn four_of_Full(kept: Full) -> vec4<f32> { return kept; }
fn Full_of(four: vec4<f32>) -> Full { return four; }
@group(0) @binding(1) var<storage, read> a1: array<{A1}>;
//#if SECOND
@group(0) @binding(2) var<storage, read> a2: array<{A2}>;
//#end
@group(0) @binding(3) var<storage, read> w: array<{W}>;
@group(0) @binding(4) var<storage, read_write> c: array<{C}>;

// Four numbers of what is multiplied.
//#if F16
alias Four = Half;
fn from_Full(kept: Full) -> Four { return Half_of(kept); }
fn from_Half(kept: Half) -> Four { return kept; }
//#else
alias Four = vec4<f32>;
fn from_Full(kept: Full) -> Four { return kept; }
fn from_Half(kept: Half) -> Four { return four_of_Half(kept); }
//#end


// Four numbers of a row of A.
fn a_four(row: u32, k: u32) -> Four {
    if (k < p.k1) { return from_{A1}(a1[(row * p.lda1 + k) / 4u]); }
    //#if SECOND
    if (k < p.k1 + p.k2) { return from_{A2}(a2[((row / p.every2) * p.lda2 + (k - p.k1)) / 4u]); }
    //#end
    return Four();
}
