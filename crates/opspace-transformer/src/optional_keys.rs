//! Schema of tables whose keys other tables of the file may state.

/// Allows a table to lack any of its keys: other tables of the file may state them.
pub(crate) fn with_optional_keys(schema: &mut schemars::Schema) {
    schema.remove("required");
}
