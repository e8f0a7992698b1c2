//! Products by matrix units: operands in f16, sums in f32.

use std::fmt::Write;

use super::Kernel;
use super::tiled::{BACK, FORWARD, PARAMETERS, WEIGHTS};

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

/// Writes the text of a product, as [`super::tiled::product`].
pub(super) fn product(kernel: &Kernel) -> String {
    let product = Product::of(kernel);
    let mut s = String::from("enable f16;\nenable wgpu_cooperative_matrix;\n");
    s.push_str(PARAMETERS);
    product.declare(&mut s);
    product.multiply(&mut s);
    product.store(&mut s);
    if product.of_weights {
        product.store_bias(&mut s);
    }
    s.push_str("}\n");
    s
}

/// What the text of a product depends on.
struct Product {
    text: &'static str,
    columns: usize,
    left: Lines,
    right: Lines,
    of_weights: bool,
    depth: &'static str,
    /// Matrices of a subgroup, down and across.
    down: usize,
    across: usize,
}

impl Product {
    fn of(kernel: &Kernel) -> Product {
        let columns = kernel.constant("COLUMNS");
        let of_weights = kernel.name == "weights";
        Product {
            text: match kernel.name {
                "weights" => WEIGHTS,
                "product_back" => BACK,
                _ => FORWARD,
            },
            columns,
            left: Lines { along_depth: !of_weights, size: ROWS },
            right: Lines { along_depth: kernel.name == "product_back", size: columns },
            of_weights,
            depth: if of_weights { "p.part_rows" } else { "(p.k1 + p.k2)" },
            down: 2,
            across: columns / 2 / SIDE,
        }
    }

    /// Its operands: what a thread has fetched of them, the tile, its lines, the function that fetches a four, and its first
    /// line.
    fn operands(&self) -> [(&'static str, &'static str, &Lines, &'static str, &'static str); 2] {
        [("a", "left", &self.left, "left_line", "row0"), ("d", "right", &self.right, "right_line", "col0")]
    }

    /// Shared memory, the entry, and a thread's variables.
    fn declare(&self, s: &mut String) {
        let Product { columns, down, across, .. } = *self;
        s.push_str(self.text);
        s.push_str(LINES);
        for (_, tile, lines, ..) in self.operands() {
            let _ = writeln!(s, "var<workgroup> {tile}: array<f16, {}>;", lines.numbers());
        }
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
        for (i, j) in (0..down).flat_map(|i| (0..across).map(move |j| (i, j))) {
            let _ = writeln!(s, "var s{i}_{j} = coop_mat16x16<f32, C>();");
        }
        s.push_str("var sums = vec4<f32>(0.0);\n");
        for (name, _, lines, ..) in self.operands() {
            for slot in 0..lines.fours() {
                let _ = writeln!(s, "var {name}{slot} = vec4<f32>(0.0);");
            }
        }
    }

    /// Fetches the parts of the operands from a depth on.
    fn fetch(&self, s: &mut String, depth: &str) {
        for (name, _, lines, function, first) in self.operands() {
            let (at, k) = if lines.along_depth { ("line", "place") } else { ("place", "line") };
            for slot in 0..lines.fours() {
                let call = format!("{function}({first} + {at}, {depth} + {k}, part)");
                let _ = writeln!(s, "{{ {} {name}{slot} = {call}; }}", lines.place(slot));
            }
        }
    }

    /// Puts what was fetched into shared memory, in f16.
    fn keep(&self, s: &mut String) {
        for (name, tile, lines, ..) in self.operands() {
            for slot in 0..lines.fours() {
                let _ = writeln!(
                    s,
                    "{{ {} let h = halves({name}{slot}); let at = line * {}u + place;\n{tile}[at] = h.x; {tile}[at + 1u] = h.y; \
                     {tile}[at + 2u] = h.z; {tile}[at + 3u] = h.w; }}",
                    lines.place(slot),
                    lines.stride()
                );
            }
        }
    }

    /// The loop over the depth.
    fn multiply(&self, s: &mut String) {
        let Product { down, across, depth, .. } = *self;
        self.fetch(s, "0u");
        let _ = writeln!(s, "for (var k0 = 0u; k0 < {depth}; k0 += {DEPTH}u) {{");
        self.keep(s);
        for slot in 0..if self.of_weights { self.right.fours() } else { 0 } {
            let _ = writeln!(s, "sums += d{slot};");
        }
        let _ = writeln!(s, "workgroupBarrier();\nif (k0 + {DEPTH}u < {depth}) {{");
        self.fetch(s, &format!("k0 + {DEPTH}u"));
        s.push_str("}\n");
        for k in (0..DEPTH).step_by(SIDE) {
            for i in 0..down {
                let _ =
                    writeln!(s, "let l{k}_{i} = {};", self.left.load("A", "left", &format!("r0 + {}u", SIDE * i), k));
            }
            for j in 0..across {
                let right = self.right.load("B", "right", &format!("c0 + {}u", SIDE * j), k);
                let _ = writeln!(s, "let r{k}_{j} = {right};");
                for i in 0..down {
                    let _ = writeln!(s, "s{i}_{j} = coopMultiplyAdd(l{k}_{i}, r{k}_{j}, s{i}_{j});");
                }
            }
        }
        s.push_str("workgroupBarrier();\n}\n");
    }

    /// Stores a subgroup's matrices, one after another through shared memory.
    fn store(&self, s: &mut String) {
        let Product { down, across, .. } = *self;
        for (i, j) in (0..down).flat_map(|i| (0..across).map(move |j| (i, j))) {
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

    /// Stores the sums of D, which all threads have parts of.
    fn store_bias(&self, s: &mut String) {
        let fours = self.columns / 4;
        let _ = writeln!(
            s,
            "for (var j = 0u; j < 4u; j++) {{ stage[4u * thread + j] = sums[j]; }}\nworkgroupBarrier();\n\
             if (thread < {fours}u && group.x == 0u) {{\nvar total = vec4<f32>(0.0);\n\
             for (var i = thread; i < {THREADS}u; i += {fours}u) {{\n\
             total += vec4<f32>(stage[4u * i], stage[4u * i + 1u], stage[4u * i + 2u], stage[4u * i + 3u]);\n}}\n\
             store_bias(col0 + 4u * thread, total, part);\n}}"
        );
    }
}

const LINES: &str = include_str!("../wgsl/matrices.wgsl");
