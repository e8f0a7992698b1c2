//! Products by tiles in shared memory, in f32.

use std::fmt::Write;

use super::Kernel;

/// Depth of a tile.
const DEPTH: usize = 16;

/// How a tile is fetched: four numbers at a time, along the depth or along the tile's rows or columns. Shared memory has it
/// along the latter, so squares of the former are transposed.
struct Lines {
    along_depth: bool,
    size: usize,
}

impl Lines {
    /// Fours, or squares, of the tile.
    fn pieces(&self) -> usize {
        if self.along_depth { self.size / 4 * DEPTH / 4 } else { self.size / 4 * DEPTH }
    }

    fn slots(&self, threads: usize) -> usize {
        self.pieces().div_ceil(threads)
    }

    /// The variables of a thread.
    fn names(&self, name: &str, threads: usize) -> Vec<String> {
        let each = if self.along_depth { 4 } else { 1 };
        (0..self.slots(threads)).flat_map(|slot| (0..each).map(move |j| format!("{name}{slot}_{j}"))).collect()
    }

    /// Depth and place of a thread's piece. A square's are those of its corner.
    fn place(&self, slot: usize, threads: usize) -> String {
        let index = format!("(thread + {}u)", slot * threads);
        let place = match self.along_depth {
            true => format!("let k = 4u * ({index} % {}u); let at = {index} / {}u;", DEPTH / 4, DEPTH / 4),
            false => format!("let k = {index} / {}u; let at = {index} % {}u;", self.size / 4, self.size / 4),
        };
        match self.pieces() % threads {
            0 => place,
            _ => format!("if ({index} < {}u) {{ {place}", self.pieces()),
        }
    }

    fn end(&self, threads: usize) -> &'static str {
        if self.pieces().is_multiple_of(threads) { "" } else { "}" }
    }

    fn fetch(&self, s: &mut String, (name, line, first): (&str, &str, &str), threads: usize, k0: &str) {
        for slot in 0..self.slots(threads) {
            let _ = writeln!(s, "{{ {}", self.place(slot, threads));
            for j in 0..if self.along_depth { 4 } else { 1 } {
                let _ = writeln!(s, "{name}{slot}_{j} = {line}({first} + 4u * at + {j}u, {k0} + k, part);");
            }
            let _ = writeln!(s, "{} }}", self.end(threads));
        }
    }

    fn keep(&self, s: &mut String, (name, tile, row): (&str, &str, usize), threads: usize) {
        for slot in 0..self.slots(threads) {
            let _ = writeln!(s, "{{ {}", self.place(slot, threads));
            if self.along_depth {
                for (k, part) in ["x", "y", "z", "w"].into_iter().enumerate() {
                    let of = |j: usize| format!("{name}{slot}_{j}.{part}");
                    let square = format!("vec4<f32>({}, {}, {}, {})", of(0), of(1), of(2), of(3));
                    let _ = writeln!(s, "{tile}[(k + {k}u) * {row}u + at] = {square};");
                }
            } else {
                let _ = writeln!(s, "{tile}[k * {row}u + at] = {name}{slot}_0;");
            }
            let _ = writeln!(s, "{} }}", self.end(threads));
        }
    }
}

/// Writes the text of a product: a group computes a tile and a thread a square of it. The depth passes through shared
/// memory, and the next part of it is fetched while this one is multiplied.
///
/// - `product`: C = A W + b, with A = [A1 | A2], by ReLU if asked, and C + X beside it with flag DELTA.
/// - `product_back`: C = D W^T over some rows of W, where the ReLU let it pass (MASK), added to C (ADD), and beside it
///   without the mask (OPEN).
/// - `weights`: a part of A^T D over some rows, with the sum of D below it.
pub(super) fn product(kernel: &Kernel) -> String {
    let product = Product::of(kernel);
    let mut s = PARAMETERS.to_string();
    product.declare(&mut s);
    product.multiply(&mut s);
    product.store(&mut s);
    s
}

/// What the text of a product depends on.
struct Product {
    text: &'static str,
    rows: usize,
    columns: usize,
    /// Rows and columns of a thread's square, and fours of its row.
    side: usize,
    fours: usize,
    threads: usize,
    left: Lines,
    right: Lines,
    /// In fours, with one more that keeps neighbours in different banks.
    left_row: usize,
    right_row: usize,
    of_weights: bool,
    has_jets: bool,
    depth: &'static str,
}

impl Product {
    fn of(kernel: &Kernel) -> Product {
        let [rows, columns, side] = ["ROWS", "COLUMNS", "SIDE"].map(|name| kernel.constant(name));
        let of_weights = kernel.name == "weights";
        Product {
            text: match kernel.name {
                "weights" => WEIGHTS,
                "product_back" => BACK,
                _ => FORWARD,
            },
            rows,
            columns,
            side,
            fours: side / 4,
            threads: rows * columns / side / side,
            left: Lines { along_depth: !of_weights, size: rows },
            right: Lines { along_depth: kernel.name == "product_back", size: columns },
            left_row: rows / 4 + 1,
            right_row: columns / 4 + 1,
            of_weights,
            has_jets: kernel.has("JETS"),
            depth: if of_weights { "p.part_rows" } else { "(p.k1 + p.k2)" },
        }
    }

    /// Shared memory, the entry, and a thread's variables: its square, and sums for the bias of weights.
    fn declare(&self, s: &mut String) {
        let Product { rows, columns, side, threads, .. } = *self;
        let _ = writeln!(s, "var<workgroup> left: array<vec4<f32>, {}>;", DEPTH * self.left_row);
        let _ = writeln!(s, "var<workgroup> right: array<vec4<f32>, {}>;", DEPTH * self.right_row);
        s.push_str(self.text);
        let _ = writeln!(
            s,
            "@compute @workgroup_size({threads})\nfn main(@builtin(workgroup_id) group: vec3<u32>, \
             @builtin(local_invocation_index) thread: u32) {{\n\
             let across = {}u; let ty = thread / across; let tx = thread % across;\n\
             let row0 = group.x * {rows}u; let col0 = group.y * {columns}u; let part = group.z;",
            columns / side
        );
        let accumulators = (0..side).flat_map(|i| (0..self.fours).map(move |q| format!("s{i}_{q}")));
        let biases = (0..self.biases()).map(|q| format!("b{q}"));
        let fetched = self.left.names("a", threads).into_iter().chain(self.right.names("d", threads));
        for name in accumulators.chain(biases).chain(fetched) {
            let _ = writeln!(s, "var {name} = vec4<f32>(0.0);");
        }
    }

    /// Fours of a thread's sums for the bias.
    fn biases(&self) -> usize {
        if self.of_weights { self.fours } else { 0 }
    }

    /// Fetches the parts of the operands from a depth on.
    fn fetch(&self, s: &mut String, depth: &str) {
        self.left.fetch(s, ("a", "left_line", "row0"), self.threads, depth);
        self.right.fetch(s, ("d", "right_line", "col0"), self.threads, depth);
    }

    /// The loop over the depth.
    fn multiply(&self, s: &mut String) {
        let Product { side, fours, threads, left_row, right_row, depth, .. } = *self;
        self.fetch(s, "0u");
        let _ = writeln!(s, "for (var k0 = 0u; k0 < {depth}; k0 += {DEPTH}u) {{");
        self.left.keep(s, ("a", "left", left_row), threads);
        self.right.keep(s, ("d", "right", right_row), threads);
        let _ = writeln!(s, "workgroupBarrier();\nif (k0 + {DEPTH}u < {depth}) {{");
        self.fetch(s, &format!("k0 + {DEPTH}u"));
        let _ = writeln!(s, "}}\nfor (var k = 0u; k < {DEPTH}u; k++) {{");
        let _ = writeln!(s, "let l = k * {left_row}u + {fours}u * ty; let r = k * {right_row}u + {fours}u * tx;");
        for q in 0..fours {
            let _ = writeln!(s, "let l{q} = left[l + {q}u]; let r{q} = right[r + {q}u];");
        }
        for i in 0..side {
            for q in 0..fours {
                let _ = writeln!(s, "s{i}_{q} = fma(vec4<f32>(l{}[{}]), r{q}, s{i}_{q});", i / 4, i % 4);
            }
        }
        // A bias has no part in derivatives.
        let counts = if self.has_jets { "if (k % 4u == 0u) " } else { "" };
        for q in 0..self.biases() {
            let _ = writeln!(s, "{counts}{{ b{q} += r{q}; }}");
        }
        s.push_str("}\nworkgroupBarrier();\n}\n");
    }

    /// Stores a thread's square, and the sums for the bias.
    fn store(&self, s: &mut String) {
        let Product { side, fours, .. } = *self;
        let is_jet = self.text == FORWARD && self.has_jets;
        for i in 0..side {
            for q in 0..fours {
                let place = format!("row0 + {side}u * ty + {i}u, col0 + {side}u * tx + {}u, s{i}_{q}", 4 * q);
                let _ = match is_jet {
                    true => writeln!(s, "store_jet({place}, s{}_{q}, part);", i - i % 4),
                    false => writeln!(s, "store_four({place}, part);"),
                };
            }
        }
        if self.of_weights {
            s.push_str("if (ty == 0u && group.x == 0u) {\n");
            for q in 0..fours {
                let _ = writeln!(s, "store_bias(col0 + {side}u * tx + {}u, b{q}, part);", 4 * q);
            }
            s.push_str("}\n");
        }
        s.push_str("}\n");
    }
}

pub(super) const PARAMETERS: &str = include_str!("../wgsl/product.wgsl");
pub(super) const FORWARD: &str = include_str!("../wgsl/product_forward.wgsl");
pub(super) const BACK: &str = include_str!("../wgsl/product_back.wgsl");
pub(super) const WEIGHTS: &str = include_str!("../wgsl/product_weights.wgsl");
