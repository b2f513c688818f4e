//! Rules for the sources and packages of all crates.

mod dependencies;
mod doc_lines;
mod file_access;
mod import_cycles;
mod imports;
mod licences;
mod old_names;
mod packages;
mod public_api;
mod schemas;
mod sentences;
