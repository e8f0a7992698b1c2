// ChaCha8 in counter mode, with the words that the host's generator reads in order: a thread a block of 16 words.
struct Random {
    stream: u32,      // of the key
    part: u32,        // of the key, of chunk 0
    part_step: u32,   // to the next chunk's part
    chunks: u32,
    count: u32,       // numbers of a chunk
    offset: u32,      // words of the stream before its first number
    blocks: u32,      // blocks of a chunk
    first: u32,       // place of chunk 0's first number
}
@group(0) @binding(0) var<uniform> p: Random;
@group(0) @binding(1) var<uniform> now: Now;
@group(0) @binding(2) var<storage, read_write> numbers: array<f32>;

fn rotl(x: u32, n: u32) -> u32 { return (x << n) | (x >> (32u - n)); }
fn quarter(s: ptr<function, array<u32, 16>>, a: u32, b: u32, c: u32, d: u32) {
    (*s)[a] += (*s)[b]; (*s)[d] = rotl((*s)[d] ^ (*s)[a], 16u);
    (*s)[c] += (*s)[d]; (*s)[b] = rotl((*s)[b] ^ (*s)[c], 12u);
    (*s)[a] += (*s)[b]; (*s)[d] = rotl((*s)[d] ^ (*s)[a], 8u);
    (*s)[c] += (*s)[d]; (*s)[b] = rotl((*s)[b] ^ (*s)[c], 7u);
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let thread = thread_of(id);
    let chunk = thread / p.blocks;
    if (chunk >= p.chunks) { return; }
    let first_block = p.offset / 16u;
    let block = first_block + thread % p.blocks;
    var start = array<u32, 16>(0x61707865u, 0x3320646eu, 0x79622d32u, 0x6b206574u,
        now.seed.x, now.seed.y, p.stream, 0u, now.step.x, now.step.y, p.part + chunk * p.part_step, 0u,
        block, 0u, 0u, 0u);
    var s = start;
    for (var round = 0u; round < 4u; round++) {
        quarter(&s, 0u, 4u, 8u, 12u); quarter(&s, 1u, 5u, 9u, 13u);
        quarter(&s, 2u, 6u, 10u, 14u); quarter(&s, 3u, 7u, 11u, 15u);
        quarter(&s, 0u, 5u, 10u, 15u); quarter(&s, 1u, 6u, 11u, 12u);
        quarter(&s, 2u, 7u, 8u, 13u); quarter(&s, 3u, 4u, 9u, 14u);
    }
    for (var i = 0u; i < 16u; i++) {
        let word = 16u * block + i;
        if (word < p.offset || word - p.offset >= p.count) { continue; }
        // 24 bits: exact.
        numbers[p.first + chunk * p.count + word - p.offset] = f32((s[i] + start[i]) >> 8u) * (1.0 / 16777216.0);
    }
}
