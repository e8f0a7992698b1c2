//! Figures, each as SVG with its caption as text.

use crate::base::Result;
use crate::report::plots::{Figure, Style, axes_figure, curves_figure, rows_figure, seconds_figure};

use super::{Collected, Exporter, File};

/// The figures of one kind, with files named `KIND_...`.
pub struct Figures {
    kind: &'static str,
    figures: fn(&Collected, Style) -> Result<Vec<Named>>,
}

/// A figure's file name without its extension, and the figure if there is one.
type Named = (String, Option<Figure>);

impl Figures {
    const fn new(kind: &'static str, figures: fn(&Collected, Style) -> Result<Vec<Named>>) -> Figures {
        Figures { kind, figures }
    }
}

/// `rows_SCENE_METRIC`: the rows of a sweep without axes. A row with its own axes has a line for each value.
pub static ROWS: Figures = Figures::new("rows_", |collected, style| {
    let table = collected.table()?;
    each_metric(collected, |scene, metric| {
        let figure = || rows_figure(style, table, collected.records, scene, metric);
        if collected.spec.varied { None } else { figure() }
    })
});

/// `axes_SCENE_METRIC`: a metric against the varied setting.
pub static AXES: Figures = Figures::new("axes_", |collected, style| {
    each_metric(collected, |scene, metric| axes_figure(style, collected.records, scene, metric))
});

/// Says in a figure's caption that it has no row with axes, if there are any.
fn without_axes(collected: &Collected, scene: &str, mut figure: Option<Figure>) -> Option<Figure> {
    if collected.records.iter().any(|record| record.scene == scene && !record.axes.is_empty()) {
        let note = |figure: &mut Figure| {
            figure.caption = format!("{} Rows with axes are not drawn.\n", figure.caption.trim_end())
        };
        figure.iter_mut().for_each(note);
    }
    figure
}

/// `curves_SCENE_psnr`: training against steps and, if clock times are shown, against seconds.
pub static CURVES: Figures = Figures::new("curves_", |collected, style| {
    let mut figures = Vec::new();
    for (scene, curves) in collected.curves {
        figures.push((format!("{scene}_psnr"), without_axes(collected, scene, curves_figure(style, scene, curves))));
        // Drawn only with clock times, since it is not reproducible.
        let seconds = without_axes(collected, scene, seconds_figure(style, scene, curves));
        figures.push((format!("{scene}_psnr_seconds"), seconds));
    }
    Ok(figures)
});

impl Exporter for Figures {
    fn needs_table(&self) -> bool {
        true
    }

    fn owns(&self, file: &str) -> bool {
        file.starts_with(self.kind) && [".svg", ".txt"].iter().any(|ending| file.ends_with(ending))
    }

    fn export(&self, collected: &Collected) -> Result<Vec<File>> {
        let figures = (self.figures)(collected, Style { spec: collected.spec })?.into_iter();
        let files = |(name, figure): Named| Some(figure?.files(&format!("{}{name}", self.kind)));
        Ok(figures.filter_map(files).flatten().collect())
    }
}

/// Makes the figure of each scene and metric.
fn each_metric(collected: &Collected, figure: impl Fn(&str, &str) -> Option<Figure>) -> Result<Vec<Named>> {
    let table = collected.table()?;
    let of_scene = |(scene, _)| table.metrics.iter().map(move |metric| (scene, metric));
    let named = |(scene, metric): (&str, &String)| (format!("{scene}_{metric}"), figure(scene, metric));
    Ok(table.scenes().into_iter().flat_map(of_scene).map(named).collect())
}
