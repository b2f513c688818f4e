//! Rows of the tables of metrics: what is known of a metric apart from its value.

use opspace_log::Recording;
use std::fmt;
use std::ops::Range;
use std::sync::Arc;

/// Values of a metric that are better.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Better {
    /// Smaller values.
    Smaller,
    /// Larger values.
    Larger,
    /// Neither: the metric describes a run.
    Neither,
}

impl Better {
    /// Name in tables.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Smaller => "smaller",
            Self::Larger => "larger",
            Self::Neither => "neither",
        }
    }
}

/// Requirement on a run for a value of a metric, as far as it is known before the run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Needs {
    /// Nothing.
    Nothing,
    /// A task with a pose.
    Pose,
    /// A task with a Cartesian frame.
    Frame,
    /// A task that tracks joint positions.
    JointTracking,
    /// A spring in the environment, which is the operator.
    Operator,
    /// Torque control of a position robot.
    TorqueToPosition,
    /// Torque control.
    Torque,
}

impl Needs {
    /// Describes the requirement; `None` if there is none.
    #[must_use]
    pub fn text(self) -> Option<&'static str> {
        Some(match self {
            Self::Nothing => return None,
            Self::Pose => "a task with a Cartesian frame or the centre of mass",
            Self::Frame => "a task with a Cartesian frame",
            Self::JointTracking => "a task of the kind `joint-tracking`",
            Self::Operator => "a task with a spring in `environment`, which is the operator",
            Self::TorqueToPosition => "a position robot with the controller `osc`",
            Self::Torque => "the controller `osc`",
        })
    }
}

/// Column of a metric in tables of results.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Column {
    /// Name in the key `columns` of a suite file.
    pub name: &'static str,
    /// Head of the column.
    pub title: &'static str,
    /// Unit of the column.
    pub unit: &'static str,
    /// Factor from the unit of the metric to that of the column.
    pub factor: f64,
    /// Requirement for a value.
    pub needs: Needs,
    /// True if tables have it that do not list their columns.
    pub by_default: bool,
}

impl Column {
    /// Creates a column that tables have if they list it.
    #[must_use]
    pub const fn new(name: &'static str, title: &'static str, unit: &'static str, factor: f64) -> Self {
        Self { name, title, unit, factor, needs: Needs::Nothing, by_default: false }
    }

    /// States what a run needs for a value.
    #[must_use]
    pub const fn needs(self, needs: Needs) -> Self {
        Self { needs, ..self }
    }

    /// Adds the column to the tables that do not list their columns.
    #[must_use]
    pub const fn by_default(self) -> Self {
        Self { by_default: true, ..self }
    }
}

/// Value of an added metric while segments of a log arrive.
pub trait LogMetric: Send {
    /// Adds the next segment of the log. `settled` are the rows of its channel `tick` in the time that statistics cover: from
    /// `settle_s` to the last control cycle.
    fn add(&mut self, segment: &Recording, settled: Range<usize>);

    /// Returns the value; `None` if the run has none.
    fn finish(self: Box<Self>) -> Option<f64>;
}

type Start = dyn Fn() -> Box<dyn LogMetric> + Send + Sync;

/// Metric of a run: one row of the table of metrics.
#[derive(Clone)]
#[non_exhaustive]
pub struct Metric {
    /// Key in summaries and expectations, with its unit at the end.
    pub key: &'static str,
    /// Values that are better.
    pub better: Better,
    /// Column in tables, if it has one.
    pub column: Option<Column>,
    /// Definition, in sentences.
    pub meaning: &'static str,
    /// Computation from a log; `None` for a built-in metric.
    start: Option<Arc<Start>>,
}

impl Metric {
    pub(crate) const fn row(
        key: &'static str,
        better: Better,
        column: Option<Column>,
        meaning: &'static str,
    ) -> Self {
        Self { key, better, column, meaning, start: None }
    }

    /// Creates a metric that `start` begins to compute for each run, from its log alone.
    #[must_use]
    pub fn new(
        key: &'static str,
        better: Better,
        meaning: &'static str,
        start: impl Fn() -> Box<dyn LogMetric> + Send + Sync + 'static,
    ) -> Self {
        Self { key, better, column: None, meaning, start: Some(Arc::new(start)) }
    }

    /// Sets the column.
    #[must_use]
    pub fn with_column(self, column: Column) -> Self {
        Self { column: Some(column), ..self }
    }

    /// Begins the computation of an added metric for a run; `None` for a built-in one.
    pub(crate) fn start(&self) -> Option<Box<dyn LogMetric>> {
        self.start.as_ref().map(|start| start())
    }
}

impl PartialEq for Metric {
    fn eq(&self, other: &Self) -> bool {
        self.key == other.key
    }
}

impl fmt::Debug for Metric {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.key)
    }
}

/// Number of a metric.
pub(crate) trait Number {
    /// Number as `f64`.
    fn number(self) -> f64;
}

impl Number for f64 {
    fn number(self) -> f64 {
        self
    }
}

impl Number for u64 {
    fn number(self) -> f64 {
        self as f64
    }
}

/// Declares a table of metrics. Its members are metrics `key: type, Better, column, "Definition.";`, other tables
/// `[doc, field: Table];` and other values `(doc, field: type);`.
macro_rules! metric_table {
    (
        $(#[$of_table:meta])*
        $table:ident {
            $(
                $([$(#[$of_group:meta])* $group:ident: $Group:ty])?
                $(($(#[$of_value:meta])* $value:ident: $Value:ty))?
                $($key:ident: $Number:ty, $better:ident, $column:expr, $meaning:literal)?
            ;)*
        }
    ) => {
        $(#[$of_table])*
        #[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
        #[non_exhaustive]
        pub struct $table {
            $(
                $($(#[$of_group])* #[serde(flatten)] pub $group: $Group,)?
                $($(#[$of_value])* pub $value: $Value,)?
                $(#[doc = $meaning] pub $key: Option<$Number>,)?
            )*
        }

        impl $table {
            /// Rows of the table, in its order.
            #[must_use]
            pub fn rows() -> Vec<$crate::metrics::metric::Metric> {
                let groups: &[Vec<$crate::metrics::metric::Metric>] = &[$(
                    $(<$Group>::rows())?
                    $({ let _ = stringify!($value); Vec::new() })?
                    $(vec![$crate::metrics::metric::Metric::row(
                        stringify!($key),
                        $crate::metrics::metric::Better::$better,
                        $column,
                        $meaning,
                    )])?
                ),*];
                groups.concat()
            }

            /// Returns a metric by its key; `None` if the table has no such metric, or the metric has no value.
            #[must_use]
            pub fn value(&self, key: &str) -> Option<f64> {
                $(
                    $(if let Some(value) = self.$group.value(key) {
                        return Some(value);
                    })?
                    $(if key == stringify!($key) {
                        return self.$key.map($crate::metrics::metric::Number::number);
                    })?
                )*
                None
            }
        }
    };
}

pub(crate) use metric_table;
