//! The kernels' texts, with what is chosen when they are compiled.

use std::fmt::Write;

mod matrices;

/// A kernel with its choices. Equal ones are compiled once.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Kernel {
    pub(crate) name: &'static str,
    /// Parts of its text that are switched on.
    flags: Vec<&'static str>,
    /// Numbers that its text names in braces.
    constants: Vec<(&'static str, usize)>,
}

macro_rules! texts {
    ($($name:literal: $($part:literal),*;)*) => {
        /// Returns the parts of a kernel's text.
        fn parts(name: &str) -> &'static [&'static str] {
            match name {
                $($name => &[$(include_str!(concat!("wgsl/", $part, ".wgsl"))),*],)*
                _ => panic!("no kernel {name}"),
            }
        }
    };
}

texts! {
    "random": "common", "random";
    "normal": "common", "normal";
    "sample": "common", "sample";
    "resample": "resample";
    "add": "common", "add";
    "copy": "common", "copy";
    "points": "common", "rays", "points";
    "frequency": "common", "waves", "frequency";
    "frequency_jets": "common", "waves", "frequency_jets";
    "frequency_back": "common", "waves_back", "frequency_back";
    "view": "common", "rays", "waves", "view";
    "view_back": "common", "rays", "waves_back", "view_back";
    "t_back": "common", "rays", "t_back";
    "domain": "common", "contraction", "domain";
    "domain_back": "common", "contraction", "domain_back";
    "encode": "common", "cell", "encode";
    "encode_jets": "common", "cell", "contraction", "encode_jets";
    "scatter": "common", "cell", "contraction", "scatter";
    "slope": "common", "cell", "slope";
    "activate": "common", "output", "activation", "activate";
    "activate_back": "common", "output", "activation", "activate_back";
    "density": "common", "activation", "density";
    "space": "common", "activation", "space_point", "space";
    "space_back": "common", "activation", "space_point", "space_back";
    "integrals": "integrals";
    "march": "common", "rays", "march";
    "composite": "common", "rays", "composite";
    "loss": "rays", "loss";
    "shift": "shift";
    "t_radius": "common", "t_radius";
    "xyz_radius": "common", "rays", "xyz_radius";
    "draw": "common", "set", "draw";
    "ascend": "common", "set", "ascend";
    "at_bound": "common", "set", "at_bound";
    "reduce": "common", "reduce";
    "check": "common", "finite", "check";
    "adam_weights": "common", "finite", "adam", "adam_weights";
    "adam_tables": "common", "finite", "adam", "adam_tables";
}

impl Kernel {
    pub(crate) fn new(name: &'static str) -> Kernel {
        Kernel { name, flags: Vec::new(), constants: Vec::new() }
    }

    /// Switches a part of the text on.
    pub(crate) fn with(mut self, flag: &'static str, on: bool) -> Kernel {
        if on {
            self.flags.push(flag);
        }
        self
    }

    /// Fills in a number.
    pub(crate) fn set(mut self, name: &'static str, value: usize) -> Kernel {
        self.constants.push((name, value));
        self
    }

    /// Returns the text in WGSL.
    pub(crate) fn text(&self) -> String {
        let mut text = match self.name {
            "product" | "product_back" | "weights" if self.has("F16") => matrices::product(self),
            "product" | "product_back" | "weights" => product(self),
            name => parts(name).concat(),
        };
        for (name, value) in &self.constants {
            text = text.replace(&format!("{{{name}}}"), &value.to_string());
        }
        chosen(&text, &self.flags)
    }

    fn has(&self, flag: &str) -> bool {
        self.flags.contains(&flag)
    }

    fn constant(&self, name: &str) -> usize {
        let found = self.constants.iter().find(|(known, _)| *known == name);
        found.expect("a constant of the kernel").1
    }
}

/// Keeps the parts between `//#if FLAG`, `//#else` and `//#end` that are switched on.
fn chosen(text: &str, flags: &[&str]) -> String {
    let mut kept = String::new();
    let mut nested: Vec<bool> = Vec::new();
    for line in text.lines() {
        let word = line.trim();
        if let Some(flag) = word.strip_prefix("//#if ") {
            nested.push(flags.contains(&flag));
        } else if word == "//#else" {
            let last = nested.last_mut().expect("an else follows an if");
            *last = !*last;
        } else if word == "//#end" {
            nested.pop().expect("an end follows an if");
        } else if nested.iter().all(|on| *on) {
            kept.push_str(line);
            kept.push('\n');
        }
    }
    kept
}

/// The kinds of tiles that an adapter has for wide layers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Tiles {
    /// 64 x 64 in f32.
    Small,
    /// 128 x 128 in f32, which needs many registers.
    Large,
    /// Matrix units: operands in f16.
    Matrices,
}

impl Tiles {
    pub(crate) fn name(self) -> &'static str {
        match self {
            Tiles::Small => "64 x 64",
            Tiles::Large => "128 x 128",
            Tiles::Matrices => "matrix units",
        }
    }
}

/// Rows and columns of a tile, and those of a thread.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Tile {
    pub(crate) rows: usize,
    pub(crate) columns: usize,
    of_thread: usize,
    pub(crate) in_f16: bool,
}

impl Tile {
    /// Returns the tile of a product with so many columns.
    pub(crate) fn of(columns: usize, tiles: Tiles) -> Tile {
        let tile = |rows: usize, columns: usize, of_thread: usize| Tile { rows, columns, of_thread, in_f16: false };
        match (columns, tiles) {
            (0..=4, _) => tile(64, 4, 4),
            (5..=16, _) => tile(64, 16, 4),
            (17..=32, _) => tile(64, 32, 4),
            (33..=64, Tiles::Matrices) => Tile { in_f16: true, ..tile(matrices::ROWS, 64, 4) },
            (_, Tiles::Matrices) => Tile { in_f16: true, ..tile(matrices::ROWS, 128, 8) },
            (128.., Tiles::Large) => tile(128, 128, 8),
            _ => tile(64, 64, 4),
        }
    }

    /// Returns the kernel of products in such tiles.
    pub(crate) fn kernel(self, name: &'static str) -> Kernel {
        Kernel::new(name).set("ROWS", self.rows).set("COLUMNS", self.columns).set("SIDE", self.of_thread)
    }
}

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
fn product(kernel: &Kernel) -> String {
    let [rows, columns, side] = ["ROWS", "COLUMNS", "SIDE"].map(|name| kernel.constant(name));
    let (threads, fours) = (rows * columns / side / side, side / 4);
    // In fours, and one more that keeps neighbours in different banks.
    let (left_row, right_row) = (rows / 4 + 1, columns / 4 + 1);
    let of_weights = kernel.name == "weights";
    let depth = if of_weights { "p.part_rows" } else { "(p.k1 + p.k2)" };
    let mut s = PARAMETERS.to_string();
    let _ = writeln!(s, "var<workgroup> left: array<vec4<f32>, {}>;", DEPTH * left_row);
    let _ = writeln!(s, "var<workgroup> right: array<vec4<f32>, {}>;", DEPTH * right_row);
    s.push_str(match kernel.name {
        "weights" => WEIGHTS,
        "product_back" => BACK,
        _ => FORWARD,
    });
    let left = Lines { along_depth: !of_weights, size: rows };
    let right = Lines { along_depth: kernel.name == "product_back", size: columns };
    let _ = writeln!(
        s,
        "@compute @workgroup_size({threads})\nfn main(@builtin(workgroup_id) group: vec3<u32>, \
         @builtin(local_invocation_index) thread: u32) {{\n\
         let across = {}u; let ty = thread / across; let tx = thread % across;\n\
         let row0 = group.x * {rows}u; let col0 = group.y * {columns}u; let part = group.z;",
        columns / side
    );
    let accumulators = (0..side).flat_map(|i| (0..fours).map(move |q| format!("s{i}_{q}")));
    let biases = (0..if of_weights { fours } else { 0 }).map(|q| format!("b{q}"));
    let fetched = left.names("a", threads).into_iter().chain(right.names("d", threads));
    for name in accumulators.chain(biases).chain(fetched) {
        let _ = writeln!(s, "var {name} = vec4<f32>(0.0);");
    }
    left.fetch(&mut s, ("a", "left_line", "row0"), threads, "0u");
    right.fetch(&mut s, ("d", "right_line", "col0"), threads, "0u");
    let _ = writeln!(s, "for (var k0 = 0u; k0 < {depth}; k0 += {DEPTH}u) {{");
    left.keep(&mut s, ("a", "left", left_row), threads);
    right.keep(&mut s, ("d", "right", right_row), threads);
    let _ = writeln!(s, "workgroupBarrier();\nif (k0 + {DEPTH}u < {depth}) {{");
    let next = format!("k0 + {DEPTH}u");
    left.fetch(&mut s, ("a", "left_line", "row0"), threads, &next);
    right.fetch(&mut s, ("d", "right_line", "col0"), threads, &next);
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
    let counts = if kernel.has("JETS") { "if (k % 4u == 0u) " } else { "" };
    for q in 0..if of_weights { fours } else { 0 } {
        let _ = writeln!(s, "{counts}{{ b{q} += r{q}; }}");
    }
    s.push_str("}\nworkgroupBarrier();\n}\n");
    let is_jet = kernel.name == "product" && kernel.has("JETS");
    for i in 0..side {
        for q in 0..fours {
            let place = format!("row0 + {side}u * ty + {i}u, col0 + {side}u * tx + {}u, s{i}_{q}", 4 * q);
            let _ = match is_jet {
                true => writeln!(s, "store_jet({place}, s{}_{q}, part);", i - i % 4),
                false => writeln!(s, "store_four({place}, part);"),
            };
        }
    }
    if of_weights {
        s.push_str("if (ty == 0u && group.x == 0u) {\n");
        for q in 0..fours {
            let _ = writeln!(s, "store_bias(col0 + {side}u * tx + {}u, b{q}, part);", 4 * q);
        }
        s.push_str("}\n");
    }
    s.push_str("}\n");
    s
}

const PARAMETERS: &str = include_str!("wgsl/product.wgsl");
const FORWARD: &str = include_str!("wgsl/product_forward.wgsl");
const BACK: &str = include_str!("wgsl/product_back.wgsl");
const WEIGHTS: &str = include_str!("wgsl/product_weights.wgsl");

#[cfg(test)]
mod tests;
