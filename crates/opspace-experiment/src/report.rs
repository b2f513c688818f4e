//! Reports: figures, and the page they stand on.

pub mod figure;
pub mod html;
pub mod page;
