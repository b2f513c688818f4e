//! Reports: figures and HTML pages.

mod collision_moments;
mod collision_views;
mod comparisons;
pub(crate) mod coupling_figures;
pub mod coupling_pages;
pub mod coupling_table;
pub mod document;
mod dot_columns;
mod energy_figure;
mod environment_shapes;
mod event_times;
pub mod figure;
pub mod html;
mod kinds;
mod lines;
mod path_figures;
mod polygon;
mod response_figures;
mod run_figures;
mod run_section;
mod slack_figure;
mod sweep_figures;
mod task_figures;
pub mod what_if;

pub use run_figures::FigureKind;
