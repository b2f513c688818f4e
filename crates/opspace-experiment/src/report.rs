//! Reports: figures and HTML pages.

pub mod document;
pub mod figure;
pub mod html;
