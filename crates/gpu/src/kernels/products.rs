//! The texts of products, by tiles in shared memory: in f32, or by matrix units.

use askama::Template;

use super::Kernel;

/// Writes the text of a product:
///
/// - `product`: C = A W + b, with A = [A1 | A2], by ReLU if asked, and C + X beside it with flag DELTA.
/// - `product_back`: C = D W^T over some rows of W, where the ReLU let it pass (MASK), added to C (ADD), and beside it
///   without the mask (OPEN).
/// - `weights`: a part of A^T D over some rows, with the sum of D below it.
pub(super) fn text(kernel: &Kernel) -> String {
    let product = Product::of(kernel);
    let written = if kernel.has("F16") { product.by_matrices().render() } else { product.in_f32(kernel).render() };
    MATRICES.iter().fold(written.expect("a template of texts and numbers"), |text, (name, flag)| {
        text.replace(name, if kernel.has(flag) { "Half" } else { "Full" })
    })
}

/// Fours in f16 on any device, and on one that computes in it.
const HELD: &str = include_str!("../wgsl/held.wgsl");
pub(super) const HALF: &str = include_str!("../wgsl/half.wgsl");
pub(super) const NATIVE_HALF: &str = include_str!("../wgsl/native_half.wgsl");

/// Which rows count.
const LISTED: &str = include_str!("../wgsl/listed.wgsl");

/// How texts name what their matrices are kept as, and the flags of those that are in f16.
const MATRICES: [(&str, &str); 6] = [
    ("{A1}", "A1_IN_F16"),
    ("{A2}", "A2_IN_F16"),
    ("{W}", "W_IN_F16"),
    ("{C}", "C_IN_F16"),
    ("{X}", "X_IN_F16"),
    ("{Y}", "Y_IN_F16"),
];

/// Writes the text of all layers of a trunk: `trunk`, or back from the gradient of what it leaves, `trunk_back`.
pub(super) fn trunk(kernel: &Kernel) -> String {
    let (width, rows, is_back) = (kernel.constant("WIDTH"), kernel.constant("ROWS"), kernel.name == "trunk_back");
    let own =
        if is_back { include_str!("../wgsl/trunk_back.wgsl") } else { include_str!("../wgsl/trunk_forward.wgsl") };
    let operands = [HELD, NATIVE_HALF, include_str!("../wgsl/trunk.wgsl"), LISTED, own].concat();
    // The gap keeps rows in different banks.
    let (line, deep) = (width / 4 + 2, rows * width / 4096);
    Trunk { operands, width, rows, line, deep, is_back }.render().expect("a template of texts and numbers")
}

/// The text of a trunk.
#[derive(Template)]
#[template(path = "trunk.wgsl", escape = "none")]
struct Trunk {
    operands: String,
    width: usize,
    /// Rows of a group.
    rows: usize,
    /// Fours of a row in shared memory.
    line: usize,
    /// Matrices of a subgroup below each other.
    deep: usize,
    is_back: bool,
}

/// What both kinds of text depend on.
struct Product {
    /// Its parameters and operands, and how these are read and stored.
    operands: String,
    rows: usize,
    columns: usize,
    name: &'static str,
    has_jets: bool,
}

/// A text in f32.
#[derive(Template)]
#[template(path = "tiled.wgsl", escape = "none")]
struct InF32 {
    product: Product,
    tiles: [Tile; 2],
    threads: usize,
    /// Rows and columns of a thread's square, and fours of its row.
    side: usize,
    fours: usize,
    /// Fours of a thread's sums for the bias.
    biases: usize,
}

/// A text by matrix units.
#[derive(Template)]
#[template(path = "matrices.wgsl", escape = "none")]
struct ByMatrices {
    product: Product,
    tiles: [Tile; 2],
    /// Matrices of a subgroup side by side.
    across: usize,
}

/// The part of an operand that is in shared memory, and how a group's threads fetch it: a piece each, slot after slot.
#[derive(Default)]
struct Tile {
    /// Its name, that of what a thread fetches, and that of its first row or column.
    name: &'static str,
    fetched: &'static str,
    first: &'static str,
    /// Whether four numbers that are fetched at once lie along the depth, not along the tile's rows or columns.
    along_depth: bool,
    /// Fours of a line, which lies along the depth or along rows or columns.
    fours: usize,
    threads: usize,
    /// Pieces: fours, or in f32 along the depth squares, which are transposed.
    pieces: usize,
    /// Fours of a line in shared memory, and of all lines.
    line: usize,
    numbers: usize,
}

impl Product {
    fn of(kernel: &Kernel) -> Product {
        let own = match kernel.name {
            "weights" => include_str!("../wgsl/product_weights.wgsl"),
            "product_back" => include_str!("../wgsl/product_back.wgsl"),
            _ => include_str!("../wgsl/product_forward.wgsl"),
        };
        let half = if kernel.has("F16") { NATIVE_HALF } else { HALF };
        Product {
            operands: [HELD, half, include_str!("../wgsl/product.wgsl"), LISTED, own].concat(),
            rows: kernel.constant("ROWS"),
            columns: kernel.constant("COLUMNS"),
            name: kernel.name,
            has_jets: kernel.has("JETS"),
        }
    }

    /// Makes the tiles of both operands from their rows or columns, and whether they are fetched along the depth.
    fn tiles(&self, tile: impl Fn(usize, bool) -> Tile) -> [Tile; 2] {
        let left = tile(self.rows, self.name != "weights");
        let right = tile(self.columns, self.name == "product_back");
        [
            Tile { name: "left", fetched: "a", first: "row0", ..left },
            Tile { name: "right", fetched: "d", first: "col0", ..right },
        ]
    }

    fn in_f32(self, kernel: &Kernel) -> InF32 {
        const DEPTH: usize = 16;
        let side = kernel.constant("SIDE");
        let threads = self.rows * self.columns / side / side;
        let tiles = self.tiles(|size, along_depth| {
            // One more four keeps neighbours in different banks.
            let (fours, line) = (size / 4, size / 4 + 1);
            let pieces = fours * if along_depth { DEPTH / 4 } else { DEPTH };
            Tile { along_depth, fours, threads, pieces, line, numbers: DEPTH * line, ..Tile::default() }
        });
        let (fours, of_weights) = (side / 4, self.name == "weights");
        InF32 { product: self, tiles, threads, side, fours, biases: if of_weights { fours } else { 0 } }
    }

    fn by_matrices(self) -> ByMatrices {
        const DEPTH: usize = 32;
        let tiles = self.tiles(|size, along_depth| {
            let length = if along_depth { DEPTH } else { size };
            // The gap keeps lines in different banks.
            let (pieces, line) = (size * DEPTH / 4, length / 4 + 2);
            let numbers = size * DEPTH / length * line;
            Tile { along_depth, fours: length / 4, threads: 256, pieces, line, numbers, ..Tile::default() }
        });
        ByMatrices { across: self.columns / 32, product: self, tiles }
    }
}

impl Tile {
    fn slots(&self) -> usize {
        self.pieces.div_ceil(self.threads)
    }

    /// Fours of a piece in f32.
    fn each(&self) -> usize {
        if self.along_depth { 4 } else { 1 }
    }

    /// Whether all threads have a piece in each slot.
    fn is_even(&self) -> bool {
        self.pieces.is_multiple_of(self.threads)
    }

    /// The expression that loads the matrix at `at` of the tile and `depth`, of role `A` or `B` on the left or the right.
    fn load(&self, role: &str, at: String, depth: &usize) -> String {
        let Tile { name, line, .. } = self;
        // Row-major is `coopLoadT`: rows of the left one, and the depth of the right one, are lines.
        let function = if self.along_depth == (role == "A") { "coopLoadT" } else { "coopLoad" };
        let place = match self.along_depth {
            true => format!("({at}) * {line}u + {}u", depth / 4),
            false => format!("{depth}u * {line}u + ({at}) / 4u"),
        };
        format!("{function}<coop_mat16x16<f16, {role}>>(&{name}[{place}], {line}u)")
    }
}
