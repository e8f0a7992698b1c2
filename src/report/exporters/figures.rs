//! Figures, each as SVG and PNG.

use crate::base::Result;
use crate::report::plots::{
    Figure, axes_figure, curves_figure, heatmap_figures, rows_figure, seconds_figure, surfaces_figure,
};

use super::{Collected, Exporter, File};

/// `rows_SCENE_METRIC`: the rows of a sweep without axes of its own; a row that has some is a line for each of its values.
pub struct Rows;

impl Exporter for Rows {
    fn needs_table(&self) -> bool {
        true
    }

    fn owns(&self, file: &str) -> bool {
        is_figure(file, "rows_")
    }

    fn export(&self, collected: &Collected) -> Result<Vec<File>> {
        of_metrics(collected, "rows", |scene, metric| match collected.spec.varied {
            true => Ok(None),
            false => rows_figure(collected.table()?, collected.records, scene, metric),
        })
    }
}

/// `axes_SCENE_METRIC`: a metric against what is varied.
pub struct Axes;

impl Exporter for Axes {
    fn needs_table(&self) -> bool {
        true
    }

    fn owns(&self, file: &str) -> bool {
        is_figure(file, "axes_")
    }

    fn export(&self, collected: &Collected) -> Result<Vec<File>> {
        of_metrics(collected, "axes", |scene, metric| axes_figure(collected.spec, collected.records, scene, metric))
    }
}

/// `heatmap_SCENE_METRIC`: a metric over two axes that are varied together; numbered where there are several.
pub struct Heatmaps;

impl Exporter for Heatmaps {
    fn needs_table(&self) -> bool {
        true
    }

    fn owns(&self, file: &str) -> bool {
        is_figure(file, "heatmap_")
    }

    fn export(&self, collected: &Collected) -> Result<Vec<File>> {
        let table = collected.table()?;
        let mut files = Vec::new();
        for (scene, _) in table.scenes() {
            for metric in &table.metrics {
                for (index, figure) in heatmap_figures(table, collected.records, scene, metric)?.into_iter().enumerate()
                {
                    let number = if index == 0 { String::new() } else { format!("_{}", index + 1) };
                    files.extend(files_of(&format!("heatmap_{scene}_{metric}{number}"), Some(figure)));
                }
            }
        }
        Ok(files)
    }
}

/// `curves_SCENE_psnr`: training, against steps and, where clocks are asked for, against seconds.
pub struct Curves;

impl Exporter for Curves {
    fn needs_table(&self) -> bool {
        true
    }

    fn owns(&self, file: &str) -> bool {
        is_figure(file, "curves_")
    }

    fn export(&self, collected: &Collected) -> Result<Vec<File>> {
        let mut files = Vec::new();
        for (scene, curves) in collected.curves {
            let title = format!("{}: training on {scene}", collected.spec.title);
            let unit = "PSNR of the step's rays (dB)";
            files.extend(files_of(&format!("curves_{scene}_psnr"), curves_figure(&title, unit, curves)?));
            // There where clocks are asked for, because it does not repeat.
            files.extend(files_of(&format!("curves_{scene}_psnr_seconds"), seconds_figure(&title, unit, curves)?));
        }
        Ok(files)
    }
}

/// `surfaces_SCENE`: the rows' surfaces, where the points drew any.
pub struct Surfaces;

impl Exporter for Surfaces {
    fn needs_table(&self) -> bool {
        true
    }

    fn owns(&self, file: &str) -> bool {
        is_figure(file, "surfaces_")
    }

    fn repeats(&self) -> bool {
        false
    }

    fn export(&self, collected: &Collected) -> Result<Vec<File>> {
        let mut files = Vec::new();
        for (scene, surfaces) in collected.surfaces {
            let title = format!("{}: surfaces of {scene}", collected.spec.title);
            files.extend(files_of(&format!("surfaces_{scene}"), surfaces_figure(&title, surfaces)?));
        }
        Ok(files)
    }
}

fn is_figure(file: &str, kind: &str) -> bool {
    file.starts_with(kind) && (file.ends_with(".svg") || file.ends_with(".png"))
}

/// A figure for each scene and metric that has one.
fn of_metrics(
    collected: &Collected,
    kind: &str,
    figure: impl Fn(&str, &str) -> Result<Option<Figure>>,
) -> Result<Vec<File>> {
    let table = collected.table()?;
    let mut files = Vec::new();
    for (scene, _) in table.scenes() {
        for metric in &table.metrics {
            files.extend(files_of(&format!("{kind}_{scene}_{metric}"), figure(scene, metric)?));
        }
    }
    Ok(files)
}

/// A figure's files, where there is one.
fn files_of(name: &str, figure: Option<Figure>) -> Vec<File> {
    figure.into_iter().flat_map(|figure| figure.files(name)).collect()
}
