//! The kernels' texts, with what is chosen when they are compiled.

mod products;

/// Rows of a tile of matrix units.
const MATRIX_ROWS: usize = 128;

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
        #[cfg(test)]
        const NAMES: &[&str] = &[$($name),*];

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
    "zero": "common", "zero";
    "halve": "common", "held", "half", "halve";
    "live": "live";
    "points": "common", "rays", "points";
    "frequency": "common", "waves", "frequency";
    "frequency_back": "common", "waves_back", "frequency_back";
    "integrated": "common", "integrated";
    "integrated_back": "common", "integrated_back";
    "gaussians": "common", "rays", "cone", "gaussians";
    "gaussians_back": "common", "rays", "cone", "gaussians_back";
    "view": "common", "rays", "waves", "view";
    "view_back": "common", "rays", "waves_back", "view_back";
    "t_back": "common", "rays", "t_back";
    "domain": "common", "contraction", "domain";
    "domain_back": "common", "contraction", "domain_back";
    "encode": "common", "cell", "contraction", "laplacian", "encode";
    "scatter": "common", "cell", "contraction", "laplacian", "scatter";
    "slope": "common", "cell", "slope";
    "activate": "common", "output", "activation", "activate";
    "activate_back": "common", "output", "activation", "activate_back";
    "density": "common", "activation", "density";
    "space": "common", "activation", "space_point", "space";
    "space_back": "common", "activation", "space_point", "space_back";
    "integrals": "sizes", "integrals";
    "march": "sizes", "rays", "along", "march";
    "composite": "sizes", "rays", "along", "composite";
    "loss": "sizes", "rays", "loss";
    "shift": "sizes", "shift";
    "draw": "common", "rays", "set", "draw";
    "ascend": "common", "rays", "set", "ascend";
    "at_bound": "common", "rays", "set", "at_bound";
    "multiply": "common", "multiply";
    "reduce": "common", "reduce";
    "check": "sizes", "common", "finite", "check";
    "adam_weights": "common", "finite", "adam", "adam_weights";
    "adam_tables": "common", "finite", "fixed", "adam", "adam_tables";
    "norm": "fixed", "norm";
    "norm_factor": "norm_factor";
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
            "product" | "product_back" | "weights" => products::text(self),
            "trunk" | "trunk_back" => products::trunk(self),
            name => parts(name).concat(),
        };
        for (name, value) in &self.constants {
            text = text.replace(&format!("{{{name}}}"), &value.to_string());
        }
        let text = chosen(&text, &self.flags);
        #[cfg(test)]
        if self.has(tests::EMULATED) {
            return tests::without_matrix_units(&text);
        }
        text
    }

    /// Has arrays in place of matrix units.
    #[cfg(test)]
    pub(crate) fn emulated(self, is_on: bool) -> Kernel {
        let is_new = self.has_matrices() && !self.has(tests::EMULATED);
        self.with(tests::EMULATED, is_on && is_new)
    }

    #[cfg(test)]
    fn has_matrices(&self) -> bool {
        self.has("F16") || self.name.starts_with("trunk")
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

/// Returns the rows of a group that computes all layers of a trunk, if the threads of a group can share what is theirs: as many as
/// its 8 subgroups have registers for, or fewer.
pub(crate) fn trunk_rows(width: usize, channels: usize, shared_bytes: usize) -> Option<usize> {
    const STAGE: usize = 4 * 2560;
    if ![64, 128, 256].contains(&width) || !channels.is_multiple_of(16) || channels > width {
        return None;
    }
    let rows = [4, 2, 1].map(|deep| 4096 * deep / width);
    rows.into_iter().find(|rows| 8 * rows * (width / 4 + 2) + STAGE <= shared_bytes)
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
            (33..=64, Tiles::Matrices) => Tile { in_f16: true, ..tile(MATRIX_ROWS, 64, 4) },
            (_, Tiles::Matrices) => Tile { in_f16: true, ..tile(MATRIX_ROWS, 128, 8) },
            (128.., Tiles::Large) => tile(128, 128, 8),
            _ => tile(64, 64, 4),
        }
    }

    /// Returns the groups of a product of so many rows and columns. Those with the same rows are neighbours, so that they find them in
    /// the card's cache.
    pub(crate) fn groups(self, rows: usize, columns: usize, parts: usize) -> [u32; 3] {
        [columns.div_ceil(self.columns) as u32, rows.div_ceil(self.rows) as u32, parts as u32]
    }

    /// Returns the kernel of products in such tiles.
    pub(crate) fn kernel(self, name: &'static str) -> Kernel {
        Kernel::new(name).set("ROWS", self.rows).set("COLUMNS", self.columns).set("SIDE", self.of_thread)
    }
}

#[cfg(test)]
mod tests;
