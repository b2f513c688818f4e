//! Schema of tables whose keys other tables of the file may state.

/// Allows a table to lack any of its keys: other tables of the file may state them.
pub(crate) fn with_optional_keys(schema: &mut schemars::Schema) {
    let required = schema.remove("required");
    for key in required.iter().flat_map(|keys| keys.as_array()).flatten().filter_map(|key| key.as_str()) {
        let of = schema.pointer_mut(&format!("/properties/{key}")).and_then(|of| of.as_object_mut());
        if let Some(of) = of.filter(|of| !of.contains_key("x-default")) {
            of.insert("x-default".to_owned(), "required, here or for a group or all joints".into());
        }
    }
}
