//! Metrics with their values: of a view, and of a run.

use serde::de::{Deserializer, MapAccess, Visitor};
use serde::ser::{SerializeMap, Serializer};
use serde::{Deserialize, Serialize};

use super::registry::{METRICS, MSE, Metric, PSNR, PSNR_OF_MEAN, SSIM, Scope, split_metrics};
use super::{Backbone, average, psnr_from_mse};

/// Values by metric, in the registry's order; none where a metric is undefined or was not measured.
#[derive(Clone, Debug, PartialEq)]
pub struct Values(Vec<(&'static Metric, Option<f64>)>);

impl Values {
    /// No value yet of the metrics that `measured` picks.
    fn of(measured: impl Fn(Scope) -> bool) -> Values {
        Values(METRICS.iter().filter(|metric| measured(metric.scope)).map(|metric| (*metric, None)).collect())
    }

    /// The value of a metric, where there is one.
    pub fn get(&self, metric: &Metric) -> Option<f64> {
        self.0.iter().find(|(known, _)| known.key == metric.key).and_then(|(_, value)| *value)
    }

    /// Sets a metric.
    ///
    /// # Panics
    /// If it is not measured here, such as one of runs in a view.
    pub fn set(&mut self, metric: &Metric, value: Option<f64>) {
        let known = self.0.iter_mut().find(|(known, _)| known.key == metric.key);
        known.unwrap_or_else(|| panic!("{} is not measured here", metric.key)).1 = value;
    }

    /// Metrics and values in order.
    pub fn iter(&self) -> impl Iterator<Item = (&'static Metric, Option<f64>)> + '_ {
        self.0.iter().copied()
    }
}

impl Serialize for Values {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(self.0.len()))?;
        self.0.iter().try_for_each(|(metric, value)| map.serialize_entry(metric.key, value))?;
        map.end()
    }
}

/// The metrics of one rendered view, as in `metrics.json`: its name, then its metrics.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ViewMetrics {
    /// The view's name.
    pub name: String,
    /// Its metrics, [`Scope::View`] and [`Scope::ViewAlone`].
    #[serde(flatten)]
    pub values: Values,
}

impl ViewMetrics {
    /// A view without numbers yet.
    pub fn new(name: &str) -> ViewMetrics {
        let values = Values::of(|scope| matches!(scope, Scope::View | Scope::ViewAlone));
        ViewMetrics { name: name.to_string(), values }
    }

    /// A metric's value, where there is one.
    pub fn get(&self, metric: &Metric) -> Option<f64> {
        self.values.get(metric)
    }
}

impl<'de> Deserialize<'de> for ViewMetrics {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<ViewMetrics, D::Error> {
        deserializer.deserialize_map(ReadView)
    }
}

/// Reads a view; metrics that a file of another version lacks stay empty, those that it has more are left out.
struct ReadView;

impl<'de> Visitor<'de> for ReadView {
    type Value = ViewMetrics;

    fn expecting(&self, formatter: &mut std::fmt::Formatter) -> std::fmt::Result {
        formatter.write_str("a view's name and metrics")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<ViewMetrics, A::Error> {
        let mut view = ViewMetrics::new("");
        while let Some(key) = map.next_key::<String>()? {
            if key == "name" {
                view.name = map.next_value()?;
            } else if let Some(known) = view.values.0.iter_mut().find(|(metric, _)| metric.key == key) {
                known.1 = map.next_value()?;
            } else {
                map.next_value::<serde::de::IgnoredAny>()?;
            }
        }
        Ok(view)
    }
}

/// The metrics of a run: means over its views, and what is measured of its surface. A mean over views of which one lacks
/// the metric is none, because a mean over the others would not be comparable.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(transparent)]
pub struct MeanMetrics(Values);

impl Default for MeanMetrics {
    fn default() -> MeanMetrics {
        MeanMetrics(Values::of(|scope| !matches!(scope, Scope::ViewAlone | Scope::Lattice | Scope::Common)))
    }
}

impl MeanMetrics {
    /// The means over `views`; everything is none for no views.
    pub fn from_views(views: &[ViewMetrics]) -> MeanMetrics {
        let mut means = MeanMetrics::default();
        for (metric, value) in &mut means.0.0 {
            if metric.scope == Scope::View {
                *value = mean(views, metric);
            }
        }
        means.set(&PSNR_OF_MEAN, mean(views, &MSE).and_then(psnr_from_mse));
        for backbone in Backbone::ALL {
            let all = (means.get(&PSNR), means.get(&SSIM), means.get(backbone.lpips()));
            let value =
                if let (Some(psnr), Some(ssim), Some(lpips)) = all { Some(average(psnr, ssim, lpips)) } else { None };
            means.set(backbone.average(), value);
        }
        means
    }

    /// Sets the metrics of training views: their means, and these minus the means over held-out views.
    pub fn set_train(&mut self, views: &[ViewMetrics]) {
        for metric in split_metrics() {
            let train = mean(views, metric);
            let gap = train.zip(self.get(metric)).map(|(train, held_out)| train - held_out);
            self.set(metric.train(), train);
            self.set(metric.gap(), gap);
        }
    }

    /// A metric's value, where there is one.
    pub fn get(&self, metric: &Metric) -> Option<f64> {
        self.0.get(metric)
    }

    /// Sets a metric of a run.
    ///
    /// # Panics
    /// If runs do not have it, such as one of single views.
    pub fn set(&mut self, metric: &Metric, value: Option<f64>) {
        self.0.set(metric, value);
    }

    /// Metrics and values in order.
    pub fn iter(&self) -> impl Iterator<Item = (&'static Metric, Option<f64>)> + '_ {
        self.0.iter()
    }
}

fn mean(views: &[ViewMetrics], metric: &Metric) -> Option<f64> {
    let values = views.iter().map(|view| view.get(metric)).collect::<Option<Vec<f64>>>()?;
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}
