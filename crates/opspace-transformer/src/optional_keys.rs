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

/// Allows an entry of a map to state nothing: other entries of the map may state all of it.
pub(crate) fn with_empty_entries(schema: &mut schemars::Schema) {
    if let Some(entry) = schema.get_mut("additionalProperties") {
        let empty = schemars::json_schema!({ "type": "object", "maxProperties": 0 });
        *entry = schemars::json_schema!({ "anyOf": [entry.clone(), empty] }).to_value();
    }
}
