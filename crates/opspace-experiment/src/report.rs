//! Reports: figures, and the page they stand on.

pub mod document;
pub mod figure;
pub mod html;
