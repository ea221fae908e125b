//! The schema of JSON that is like one example, so that Foxglove offers its fields.

use serde_json::{Map, Value, json};

/// A JSON schema for values that are like `example`; what is null in it may be anything.
pub(crate) fn schema_of(example: &Value) -> Value {
    match example {
        Value::Null => json!({}),
        Value::Bool(_) => json!({ "type": "boolean" }),
        Value::Number(number) if number.is_f64() => json!({ "type": "number" }),
        Value::Number(_) => json!({ "type": "integer" }),
        Value::String(_) => json!({ "type": "string" }),
        Value::Array(elements) => {
            let items = elements.first().map_or_else(|| json!({}), schema_of);
            json!({ "type": "array", "items": items })
        }
        Value::Object(members) => {
            let properties: Map<String, Value> =
                members.iter().map(|(name, value)| (name.clone(), schema_of(value))).collect();
            json!({ "type": "object", "properties": properties })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn schema_names_every_field_down_to_the_last() {
        let example = json!({ "module": "fcu", "late": 2, "use": 0.5, "next": null, "partitions": [{ "pid": 7 }], "none": [] });
        let schema = schema_of(&example);
        assert_eq!(schema["properties"]["partitions"]["items"]["properties"]["pid"]["type"], "integer");
        assert_eq!(schema["properties"]["use"]["type"], "number");
        assert_eq!(schema["properties"]["next"], json!({}));
        assert_eq!(schema["properties"]["none"], json!({ "type": "array", "items": {} }));
    }
}
