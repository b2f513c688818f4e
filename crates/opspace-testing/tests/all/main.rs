//! Rules that the sources of all crates obey.

mod doc_lines;
mod import_cycles;
mod old_names;
