//! As much of JSON Schema as docs/stats.schema.json uses.

use serde_json::Value;

/// What of `value` does not conform to `schema`, a part of `root`. What the schema does not name is a fault, too: it would be undocumented.
pub fn faults_of(value: &Value, schema: &Value, root: &Value, place: &str) -> Vec<String> {
    if let Some(reference) = schema["$ref"].as_str() {
        let target = root.pointer(reference.trim_start_matches('#'));
        let target = target.unwrap_or_else(|| panic!("{reference} leads nowhere"));
        return faults_of(value, target, root, place);
    }
    if let Some(choices) = schema["anyOf"].as_array() {
        let tried = choices.iter().map(|choice| faults_of(value, choice, root, place));
        return tried.min_by_key(Vec::len).unwrap_or_default();
    }
    let mut faults = Vec::new();
    let types: Vec<&str> = match &schema["type"] {
        Value::String(one) => vec![one],
        Value::Array(several) => several.iter().filter_map(Value::as_str).collect(),
        _ => panic!("{place}: no type in {schema}"),
    };
    if !types.iter().any(|name| is_of_type(value, name)) {
        return vec![format!("{place}: found {value}, expected {types:?}")];
    }
    if value.as_f64().zip(schema["minimum"].as_f64()).is_some_and(|(found, least)| found < least) {
        faults.push(format!("{place}: {value} is below the minimum"));
    }
    if let Some(items) = value.as_array() {
        let of = |(i, item)| faults_of(item, &schema["items"], root, &format!("{place}[{i}]"));
        faults.extend(items.iter().enumerate().flat_map(of));
    }
    if let Some(fields) = value.as_object() {
        let required = schema["required"].as_array().into_iter().flatten();
        let missing = required.filter_map(Value::as_str).filter(|name| !fields.contains_key(*name));
        faults.extend(missing.map(|name| format!("{place}: there is no {name}")));
        for (name, value) in fields {
            let inner = format!("{place}.{name}");
            match schema["properties"].get(name) {
                Some(schema) => faults.extend(faults_of(value, schema, root, &inner)),
                None => faults.push(format!("{inner}: is not in the schema")),
            }
        }
    }
    faults
}

fn is_of_type(value: &Value, name: &str) -> bool {
    match name {
        "object" => value.is_object(),
        "array" => value.is_array(),
        "string" => value.is_string(),
        "boolean" => value.is_boolean(),
        "null" => value.is_null(),
        "number" => value.is_number(),
        "integer" => value.is_i64() || value.is_u64(),
        other => panic!("the type {other} is not known"),
    }
}

#[test]
fn what_does_not_conform_is_found() {
    let schema = serde_json::json!({
        "$defs": { "Part": { "type": "object", "properties": { "n": { "type": "integer", "minimum": 0 } },
                             "required": ["n"] } },
        "type": "object",
        "properties": { "part": { "anyOf": [{ "$ref": "#/$defs/Part" }, { "type": "null" }] },
                        "list": { "type": "array", "items": { "type": ["string", "null"] } } },
        "required": ["part"]
    });
    let check = |value: Value| faults_of(&value, &schema, &schema, "$").len();
    assert_eq!(check(serde_json::json!({ "part": { "n": 3 }, "list": ["a", null] })), 0);
    assert_eq!(check(serde_json::json!({ "part": null })), 0);
    for bad in [
        serde_json::json!({}),
        serde_json::json!({ "part": { "n": -1 } }),
        serde_json::json!({ "part": { "n": 1.5 } }),
        serde_json::json!({ "part": null, "list": [1] }),
        serde_json::json!({ "part": null, "more": 1 }),
    ] {
        assert!(check(bad.clone()) > 0, "{bad}");
    }
}
