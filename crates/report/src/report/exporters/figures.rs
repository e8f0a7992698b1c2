//! Figures, each as SVG and PNG, with its caption as text.

use crate::base::Result;
use crate::report::plots::{
    Figure, Style, Width, axes_figure, curves_figure, heatmap_figures, rows_figure, seconds_figure, shifts_figure,
    surfaces_figure,
};

use super::{Collected, Exporter, File};

/// The figures of one kind, with files named `KIND_...` for a page and `KIND_..._column` for a column.
pub struct Figures {
    kind: &'static str,
    repeats: bool,
    figures: fn(&Collected, Style) -> Result<Vec<Named>>,
}

/// A figure's file name without its extension, and the figure if there is one.
type Named = (String, Option<Figure>);

impl Figures {
    const fn new(kind: &'static str, figures: fn(&Collected, Style) -> Result<Vec<Named>>) -> Figures {
        Figures { kind, repeats: true, figures }
    }
}

/// `rows_SCENE_METRIC`: the rows of a sweep without axes. A row with its own axes has a line for each value.
pub static ROWS: Figures = Figures::new("rows_", |collected, style| {
    let table = collected.table()?;
    each_metric(collected, |scene, metric| match collected.spec.varied {
        true => Ok(vec![]),
        false => Ok(vec![rows_figure(style, table, collected.records, scene, metric)?]),
    })
});

/// `axes_SCENE_METRIC`: a metric against the varied setting.
pub static AXES: Figures = Figures::new("axes_", |collected, style| {
    each_metric(collected, |scene, metric| Ok(vec![axes_figure(style, collected.records, scene, metric)?]))
});

/// `heatmap_SCENE_METRIC`: a metric over two axes that are varied together; several are numbered.
pub static HEATMAPS: Figures = Figures::new("heatmap_", |collected, style| {
    let table = collected.table()?;
    each_metric(collected, |scene, metric| {
        let figures = heatmap_figures(style, table, collected.records, scene, metric)?;
        Ok(figures.into_iter().map(Some).collect())
    })
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
        figures.push((format!("{scene}_psnr"), without_axes(collected, scene, curves_figure(style, scene, curves)?)));
        // Drawn only with clock times, since it is not reproducible.
        let seconds = without_axes(collected, scene, seconds_figure(style, scene, curves)?);
        figures.push((format!("{scene}_psnr_seconds"), seconds));
    }
    Ok(figures)
});

/// `attack_SCENE`: how far the attack's deltas move colours during training, one panel a site.
pub static ATTACK: Figures = Figures::new("attack_", |collected, style| {
    let of = |(scene, shifts): &(String, Vec<_>)| {
        Ok((scene.clone(), without_axes(collected, scene, shifts_figure(style, scene, shifts)?)))
    };
    collected.shifts.iter().map(of).collect()
});

/// `surfaces_SCENE`: the rows' surfaces, if the points drew any.
pub static SURFACES: Figures = Figures {
    repeats: false,
    ..Figures::new("surfaces_", |collected, style| {
        let of = |(scene, surfaces): &(String, Vec<_>)| Ok((scene.clone(), surfaces_figure(style, scene, surfaces)?));
        collected.surfaces.iter().map(of).collect()
    })
};

impl Exporter for Figures {
    fn needs_table(&self) -> bool {
        true
    }

    fn owns(&self, file: &str) -> bool {
        file.starts_with(self.kind) && [".svg", ".png", ".txt"].iter().any(|ending| file.ends_with(ending))
    }

    fn repeats(&self) -> bool {
        self.repeats
    }

    fn export(&self, collected: &Collected) -> Result<Vec<File>> {
        let mut files = Vec::new();
        for width in Width::ALL {
            for (name, figure) in (self.figures)(collected, Style { spec: collected.spec, width })? {
                let name = format!("{}{name}{}", self.kind, width.suffix());
                files.extend(figure.into_iter().flat_map(|figure| figure.files(&name)));
            }
        }
        Ok(files)
    }
}

/// Makes the figures of each scene and metric, numbered from the second on.
fn each_metric(
    collected: &Collected,
    figures: impl Fn(&str, &str) -> Result<Vec<Option<Figure>>>,
) -> Result<Vec<Named>> {
    let table = collected.table()?;
    let mut named = Vec::new();
    for (scene, _) in table.scenes() {
        for metric in &table.metrics {
            for (index, figure) in figures(scene, metric)?.into_iter().enumerate() {
                let number = if index == 0 { String::new() } else { format!("_{}", index + 1) };
                named.push((format!("{scene}_{metric}{number}"), figure));
            }
        }
    }
    Ok(named)
}
