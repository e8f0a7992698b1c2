// Numbers of a ray that a pass leaves, and of a slot of results.
const OUT: u32 = 12u;
const SLOT: u32 = 20u;
