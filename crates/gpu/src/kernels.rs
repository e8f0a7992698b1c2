//! The kernels' texts, with what is chosen when they are compiled.

use std::fmt::Write;

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
    "points": "common", "rays", "points";
    "frequency": "common", "waves", "frequency";
    "frequency_back": "common", "waves_back", "frequency_back";
    "view": "common", "rays", "waves", "view";
    "view_back": "common", "rays", "waves_back", "view_back";
    "t_back": "common", "rays", "t_back";
    "domain": "common", "domain";
    "domain_back": "common", "domain_back";
    "encode": "common", "cell", "encode";
    "scatter": "common", "cell", "scatter";
    "slope": "common", "cell", "slope";
    "activate": "common", "output", "activate";
    "activate_back": "common", "output", "activate_back";
    "density": "common", "output", "density";
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
    "adam_weights": "common", "adam", "adam_weights";
    "adam_tables": "common", "adam", "adam_tables";
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
            "product" | "product_back" | "weights" => product(self),
            name => parts(name).concat(),
        };
        for (name, value) in &self.constants {
            text = text.replace(&format!("{{{name}}}"), &value.to_string());
        }
        chosen(&text.replace("{HEAD_ACCESS}", "read"), &self.flags)
    }

    fn constant(&self, name: &str) -> usize {
        let found = self.constants.iter().find(|(known, _)| *known == name);
        found.expect("a constant of the kernel").1
    }

    fn has(&self, flag: &str) -> bool {
        self.flags.contains(&flag)
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

/// Rows and columns of a tile, and those of a thread.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Tile {
    pub(crate) rows: usize,
    pub(crate) columns: usize,
    pub(crate) of_thread: usize,
}

impl Tile {
    /// Returns the tile of a product with so many columns.
    pub(crate) fn of(columns: usize, large: bool) -> Tile {
        match columns {
            0..=4 => Tile { rows: 64, columns: 4, of_thread: 4 },
            5..=16 => Tile { rows: 64, columns: 16, of_thread: 4 },
            17..=32 => Tile { rows: 64, columns: 32, of_thread: 4 },
            128.. if large => Tile { rows: 128, columns: 128, of_thread: 8 },
            _ => Tile { rows: 64, columns: 64, of_thread: 4 },
        }
    }

    /// Returns the kernel of products in such tiles.
    pub(crate) fn kernel(self, name: &'static str) -> Kernel {
        Kernel::new(name).set("ROWS", self.rows).set("COLUMNS", self.columns).set("SIDE", self.of_thread)
    }
}

/// Depth of a tile.
const DEPTH: usize = 16;

/// Writes the text of a product: a group computes a tile, a thread a square of it, the depth passes through shared
/// memory.
///
/// - `product`: C = A W + b, with A = [A1 | A2], by ReLU if asked, and C + X beside it with flag DELTA.
/// - `product_back`: C = D W^T over some rows of W, where the ReLU let it pass (MASK), added to C (ADD), and beside it
///   without the mask (OPEN).
/// - `weights`: a part of A^T D over some rows, with the sum of D below it.
fn product(kernel: &Kernel) -> String {
    let [rows, columns, side] = ["ROWS", "COLUMNS", "SIDE"].map(|name| kernel.constant(name));
    let threads = rows * columns / side / side;
    let (left_row, right_row) = (rows + 1, columns + 1);
    let mut s = String::new();
    let back = kernel.name == "product_back";
    let weights = kernel.name == "weights";
    s.push_str(
        "struct Product {\n    m: u32, n: u32, k1: u32, k2: u32, lda1: u32, lda2: u32, every2: u32, ldw: u32,\n    w_from: u32, \
         ldc: u32, c_from: u32, relu: u32, ldx: u32, part_rows: u32, parameters: u32, to: u32,\n}\n\
         @group(0) @binding(0) var<uniform> p: Product;\n\
         @group(0) @binding(1) var<storage, read> a1: array<f32>;\n",
    );
    if kernel.has("SECOND") {
        s.push_str("@group(0) @binding(2) var<storage, read> a2: array<f32>;\n");
    }
    s.push_str("@group(0) @binding(3) var<storage, read> w: array<f32>;\n");
    s.push_str("@group(0) @binding(4) var<storage, read_write> c: array<f32>;\n");
    if kernel.has("DELTA") || kernel.has("MASK") {
        s.push_str("@group(0) @binding(5) var<storage, read> x: array<f32>;\n");
    }
    if kernel.has("DELTA") || kernel.has("OPEN") {
        s.push_str("@group(0) @binding(6) var<storage, read_write> y: array<f32>;\n");
    }
    let _ = writeln!(s, "var<workgroup> left: array<f32, {}>;", DEPTH * left_row);
    let _ = writeln!(s, "var<workgroup> right: array<f32, {}>;", DEPTH * right_row);
    let second = if kernel.has("SECOND") {
        "    if (k < p.k1 + p.k2) { return a2[(row / p.every2) * p.lda2 + (k - p.k1)]; }\n"
    } else {
        ""
    };
    let _ = writeln!(
        s,
        "fn a_of(row: u32, k: u32) -> f32 {{\n    if (k < p.k1) {{ return a1[row * p.lda1 + k]; }}\n{second}    return 0.0;\n}}"
    );
    let _ = writeln!(
        s,
        "@compute @workgroup_size({threads})\nfn main(@builtin(workgroup_id) group: vec3<u32>, \
         @builtin(local_invocation_index) thread: u32) {{"
    );
    let across = columns / side;
    let _ = writeln!(s, "let ty = thread / {across}u; let tx = thread % {across}u;");
    let _ = writeln!(s, "let row0 = group.x * {rows}u; let col0 = group.y * {columns}u;");
    for i in 0..side {
        for q in 0..side / 4 {
            let _ = writeln!(s, "var s{i}_{q} = vec4<f32>(0.0);");
        }
    }
    if weights {
        for q in 0..side / 4 {
            let _ = writeln!(s, "var b{q} = vec4<f32>(0.0);");
        }
    }
    let depth = match kernel.name {
        "weights" => "p.part_rows",
        _ => "(p.k1 + p.k2)",
    };
    let _ = writeln!(s, "for (var k0 = 0u; k0 < {depth}; k0 += {DEPTH}u) {{");
    // The left tile: left[k][row].
    let _ = writeln!(s, "for (var i = thread; i < {}u; i += {threads}u) {{", rows * DEPTH);
    if weights {
        let _ = writeln!(
            s,
            "let k = i / {rows}u; let at = i % {rows}u; let row = group.z * p.part_rows + k0 + k; let col = row0 + at;\n\
             var value = 0.0; if (row < p.m && k0 + k < p.part_rows && col < p.k1 + p.k2) {{ value = a_of(row, col); }}\n\
             left[k * {left_row}u + at] = value; }}"
        );
    } else {
        let _ = writeln!(
            s,
            "let k = i % {DEPTH}u; let at = i / {DEPTH}u; let row = row0 + at;\n\
             var value = 0.0; if (row < p.m && k0 + k < {depth}) {{ value = a_of(row, k0 + k); }}\n\
             left[k * {left_row}u + at] = value; }}"
        );
    }
    // The right tile: right[k][column].
    let _ = writeln!(s, "for (var i = thread; i < {}u; i += {threads}u) {{", columns * DEPTH);
    if weights {
        let _ = writeln!(
            s,
            "let k = i / {columns}u; let at = i % {columns}u; let row = group.z * p.part_rows + k0 + k; let col = col0 + at;\n\
             var value = 0.0; if (row < p.m && k0 + k < p.part_rows && col < p.n) {{ value = w[row * p.ldw + col]; }}"
        );
    } else if back {
        let _ = writeln!(
            s,
            "let k = i % {DEPTH}u; let at = i / {DEPTH}u; let col = col0 + at;\n\
             var value = 0.0; if (k0 + k < {depth} && col < p.n) {{ value = w[p.w_from + col * p.ldw + k0 + k]; }}"
        );
    } else {
        let _ = writeln!(
            s,
            "let k = i / {columns}u; let at = i % {columns}u; let col = col0 + at;\n\
             var value = 0.0; if (k0 + k < {depth} && col < p.n) {{ value = w[p.w_from + (k0 + k) * p.ldw + col]; }}"
        );
    }
    let _ = writeln!(s, "right[k * {right_row}u + at] = value; }}\nworkgroupBarrier();");
    let _ = writeln!(s, "for (var k = 0u; k < {DEPTH}u; k++) {{");
    let _ = writeln!(s, "let l = k * {left_row}u + {side}u * ty; let r = k * {right_row}u + {side}u * tx;");
    for q in 0..side / 4 {
        let at = |j: usize| 4 * q + j;
        let _ = writeln!(
            s,
            "let r{q} = vec4<f32>(right[r + {}u], right[r + {}u], right[r + {}u], right[r + {}u]);",
            at(0),
            at(1),
            at(2),
            at(3)
        );
    }
    for i in 0..side {
        let _ = writeln!(s, "let l{i} = vec4<f32>(left[l + {i}u]);");
        for q in 0..side / 4 {
            let _ = writeln!(s, "s{i}_{q} = fma(l{i}, r{q}, s{i}_{q});");
        }
    }
    if weights {
        for q in 0..side / 4 {
            let _ = writeln!(s, "b{q} += r{q};");
        }
    }
    let _ = writeln!(s, "}}\nworkgroupBarrier();\n}}");
    for i in 0..side {
        let _ = writeln!(s, "{{ let row = row0 + {side}u * ty + {i}u;");
        for q in 0..side / 4 {
            for j in 0..4 {
                let _ = writeln!(s, "store(row, col0 + {side}u * tx + {}u, s{i}_{q}[{j}], group.z);", 4 * q + j);
            }
        }
        s.push_str("}\n");
    }
    if weights {
        s.push_str("if (ty == 0u && group.x == 0u) {\n");
        for q in 0..side / 4 {
            for j in 0..4 {
                let _ = writeln!(s, "store_bias(col0 + {side}u * tx + {}u, b{q}[{j}], group.z);", 4 * q + j);
            }
        }
        s.push_str("}\n");
    }
    s.push_str("}\n");
    s.push_str(match kernel.name {
        "weights" => {
            "fn store(row: u32, col: u32, value: f32, part: u32) {\n\
             if (row >= p.k1 + p.k2 || col >= p.n) { return; }\n\
             c[part * p.parameters + p.to + row * p.n + col] = value;\n}\n\
             fn store_bias(col: u32, value: f32, part: u32) {\n\
             if (col < p.n) { c[part * p.parameters + p.to + (p.k1 + p.k2) * p.n + col] = value; }\n}\n"
        }
        "product_back" => {
            "fn store(row: u32, col: u32, value: f32, part: u32) {\n\
             if (row >= p.m || col >= p.n) { return; }\n\
             let at = p.c_from + row * p.ldc + col;\n\
             var v = value;\n\
             //#if ADD\nv += c[at];\n//#end\n\
             //#if OPEN\ny[row * p.ldx + col] = v;\n//#end\n\
             //#if MASK\nif (x[row * p.ldx + col] <= 0.0) { v = 0.0; }\n//#end\n\
             c[at] = v;\n}\n"
        }
        _ => {
            "fn store(row: u32, col: u32, value: f32, part: u32) {\n\
             if (row >= p.m || col >= p.n) { return; }\n\
             var v = value + w[p.w_from + (p.k1 + p.k2) * p.ldw + col];\n\
             if (p.relu == 1u && v < 0.0) { v = 0.0; }\n\
             c[p.c_from + row * p.ldc + col] = v;\n\
             //#if DELTA\ny[row * p.ldx + col] = v + x[row * p.ldx + col];\n//#end\n}\n"
        }
    });
    s
}
