//! Products by matrix units: operands in f16, sums in f32.

use std::fmt::Write;

use super::{BACK, FORWARD, Kernel, PARAMETERS, WEIGHTS};

/// Rows of a tile.
pub(crate) const ROWS: usize = 128;
/// Threads of a group: 8 subgroups of 32, each with 32 rows and half of the columns.
const THREADS: usize = 256;
/// Depth of a tile.
const DEPTH: usize = 32;
/// Sides of a matrix.
const SIDE: usize = 16;
/// Numbers between two lines of a tile that keep lines in different banks.
const GAP: usize = 8;

/// How a tile lies in shared memory.
struct Lines {
    /// Lines along the depth, not along the tile's rows or columns.
    along_depth: bool,
    /// Rows or columns of the tile.
    size: usize,
}

impl Lines {
    /// Numbers of a line.
    fn length(&self) -> usize {
        if self.along_depth { DEPTH } else { self.size }
    }

    fn stride(&self) -> usize {
        self.length() + GAP
    }

    fn numbers(&self) -> usize {
        self.size * DEPTH / self.length() * self.stride()
    }

    /// Fours that a thread fetches.
    fn fours(&self) -> usize {
        self.size * DEPTH / 4 / THREADS
    }

    /// Line and place of a thread's four.
    fn place(&self, slot: usize) -> String {
        let (index, fours) = (format!("(thread + {}u)", slot * THREADS), self.length() / 4);
        format!("let line = {index} / {fours}u; let place = 4u * ({index} % {fours}u);")
    }

    /// The expression that loads the matrix at `at` of the tile and `depth`, with `columns` if it stands as the right one.
    fn load(&self, role: &str, tile: &str, at: &str, depth: usize) -> String {
        // Row-major is `coopLoadT`: rows of the left one, and the depth of the right one, are lines.
        let is_row_major = self.along_depth == (role == "A");
        let function = if is_row_major { "coopLoadT" } else { "coopLoad" };
        let stride = self.stride();
        let place = match self.along_depth {
            true => format!("({at}) * {stride}u + {depth}u"),
            false => format!("{depth}u * {stride}u + {at}"),
        };
        format!("{function}<coop_mat16x16<f16, {role}>>(&{tile}[{place}], {stride}u)")
    }
}

/// Writes the text of a product, as [`super::product`].
pub(super) fn product(kernel: &Kernel) -> String {
    let columns = kernel.constant("COLUMNS");
    let of_weights = kernel.name == "weights";
    let left = Lines { along_depth: !of_weights, size: ROWS };
    let right = Lines { along_depth: kernel.name == "product_back", size: columns };
    let depth = if of_weights { "p.part_rows" } else { "(p.k1 + p.k2)" };
    let (down, across) = (2, columns / 2 / SIDE);
    let mut s = String::from("enable f16;\nenable wgpu_cooperative_matrix;\n");
    s.push_str(PARAMETERS);
    s.push_str(match kernel.name {
        "weights" => WEIGHTS,
        "product_back" => BACK,
        _ => FORWARD,
    });
    s.push_str(LINES);
    let _ = writeln!(s, "var<workgroup> left: array<f16, {}>;", left.numbers());
    let _ = writeln!(s, "var<workgroup> right: array<f16, {}>;", right.numbers());
    // A matrix of each subgroup, or the threads' sums of D.
    s.push_str("var<workgroup> stage: array<f32, 2560>;\n");
    let _ = writeln!(
        s,
        "@compute @workgroup_size({THREADS})\nfn main(@builtin(workgroup_id) group: vec3<u32>, \
         @builtin(local_invocation_index) thread: u32) {{\n\
         let row0 = group.x * {ROWS}u; let col0 = group.y * {columns}u; let part = group.z;\n\
         let subgroup = thread / 32u; let lane = thread % 32u;\n\
         let r0 = (subgroup / 2u) * 32u; let c0 = (subgroup % 2u) * {}u;",
        columns / 2
    );
    for i in 0..down {
        for j in 0..across {
            let _ = writeln!(s, "var s{i}_{j} = coop_mat16x16<f32, C>();");
        }
    }
    s.push_str("var sums = vec4<f32>(0.0);\n");
    let names = |name: &str, lines: &Lines| (0..lines.fours()).map(|i| format!("{name}{i}")).collect::<Vec<_>>();
    let (lefts, rights) = (names("a", &left), names("d", &right));
    for name in lefts.iter().chain(&rights) {
        let _ = writeln!(s, "var {name} = vec4<f32>(0.0);");
    }
    let fetch = |s: &mut String, k0: &str| {
        for (slot, name) in lefts.iter().enumerate() {
            let (at, k) = if left.along_depth { ("line", "place") } else { ("place", "line") };
            let call = format!("left_line(row0 + {at}, {k0} + {k}, part)");
            let _ = writeln!(s, "{{ {} {name} = {call}; }}", left.place(slot));
        }
        for (slot, name) in rights.iter().enumerate() {
            let (at, k) = if right.along_depth { ("line", "place") } else { ("place", "line") };
            let call = format!("right_line(col0 + {at}, {k0} + {k}, part)");
            let _ = writeln!(s, "{{ {} {name} = {call}; }}", right.place(slot));
        }
    };
    fetch(&mut s, "0u");
    let _ = writeln!(s, "for (var k0 = 0u; k0 < {depth}; k0 += {DEPTH}u) {{");
    for (tile, lines, names) in [("left", &left, &lefts), ("right", &right, &rights)] {
        for (slot, name) in names.iter().enumerate() {
            let _ = writeln!(
                s,
                "{{ {} let h = halves({name}); let at = line * {}u + place;\n{tile}[at] = h.x; {tile}[at + 1u] = h.y; \
                 {tile}[at + 2u] = h.z; {tile}[at + 3u] = h.w; }}",
                lines.place(slot),
                lines.stride()
            );
        }
    }
    if of_weights {
        rights.iter().for_each(|name| s.push_str(&format!("sums += {name};\n")));
    }
    let _ = writeln!(s, "workgroupBarrier();\nif (k0 + {DEPTH}u < {depth}) {{");
    fetch(&mut s, &format!("k0 + {DEPTH}u"));
    s.push_str("}\n");
    for k in (0..DEPTH).step_by(SIDE) {
        for i in 0..down {
            let _ = writeln!(s, "let l{k}_{i} = {};", left.load("A", "left", &format!("r0 + {}u", SIDE * i), k));
        }
        for j in 0..across {
            let _ = writeln!(s, "let r{k}_{j} = {};", right.load("B", "right", &format!("c0 + {}u", SIDE * j), k));
            for i in 0..down {
                let _ = writeln!(s, "s{i}_{j} = coopMultiplyAdd(l{k}_{i}, r{k}_{j}, s{i}_{j});");
            }
        }
    }
    s.push_str("workgroupBarrier();\n}\n");
    for i in 0..down {
        for j in 0..across {
            let _ = writeln!(
                s,
                "coopStoreT(s{i}_{j}, &stage[subgroup * 320u], 20u);\nworkgroupBarrier();\n\
                 {{ let at = subgroup * 320u + (lane / 2u) * 20u + (lane % 2u) * 8u;\n\
                 let row = row0 + r0 + {}u + lane / 2u; let col = col0 + c0 + {}u + (lane % 2u) * 8u;\n\
                 store_four(row, col, vec4<f32>(stage[at], stage[at + 1u], stage[at + 2u], stage[at + 3u]), part);\n\
                 store_four(row, col + 4u, vec4<f32>(stage[at + 4u], stage[at + 5u], stage[at + 6u], stage[at + 7u]), part); \
                 }}\nworkgroupBarrier();",
                SIDE * i,
                SIDE * j
            );
        }
    }
    if of_weights {
        let fours = columns / 4;
        let _ = writeln!(
            s,
            "for (var j = 0u; j < 4u; j++) {{ stage[4u * thread + j] = sums[j]; }}\nworkgroupBarrier();\n\
             if (thread < {fours}u && group.x == 0u) {{\nvar total = vec4<f32>(0.0);\n\
             for (var i = thread; i < {THREADS}u; i += {fours}u) {{\n\
             total += vec4<f32>(stage[4u * i], stage[4u * i + 1u], stage[4u * i + 2u], stage[4u * i + 3u]);\n}}\n\
             store_bias(col0 + 4u * thread, total, part);\n}}"
        );
    }
    s.push_str("}\n");
    s
}

const LINES: &str = include_str!("../wgsl/matrices.wgsl");
