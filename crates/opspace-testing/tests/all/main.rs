//! Rules that the sources and the packages of all crates obey.

mod dependencies;
mod doc_lines;
mod import_cycles;
mod licences;
mod old_names;
mod packages;
mod public_api;
