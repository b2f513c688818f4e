//! Reports: figures and HTML pages.

pub mod document;
pub mod figure;
pub mod html;
pub mod what_if;
