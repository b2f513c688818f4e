//! Tests of figures and pages.

mod collision_views;
mod player;
mod report;
mod run_figures;
mod segments;
