//! Figures and pages about runs, and folders with log, summary and page.

mod collision_moments;
mod collision_views;
mod comparisons;
mod coupling_figures;
pub mod coupling_pages;
pub mod coupling_table;
pub mod document;
mod dot_columns;
mod energy_figure;
mod environment_shapes;
mod event_times;
pub mod figure;
pub mod folder;
pub mod html;
mod kinds;
mod lines;
mod move_to_start;
mod path_figures;
mod player;
mod polygon;
mod response_figures;
mod run_figures;
mod run_pictures;
mod run_section;
mod scenario_run;
mod slack_figure;
mod sweep_figures;
mod task_figures;
#[cfg(test)]
mod test_summary;
pub mod what_if;

pub use move_to_start::move_to_start;
pub use run_figures::FigureKind;
pub use scenario_run::{
    LeftBehind, run_arms_in_folder, run_in_folder, run_on_drivers, run_on_drivers_with, summary_and_page,
};
