//! How the values of a message lie in its bytes, read from the schema that the log itself carries: a log can be taken
//! apart by a build that does not know its messages.

use std::fmt::Write as _;

use bateleur_messages::format::{Body, FieldKind, Scalar, Type};
use serde_json::{Map, Value, json};

/// The type of a channel, by the log's own word. Two are equal where bytes mean the same to both, whatever is said about them.
#[derive(Debug, Clone)]
pub struct Layout(Type);

impl PartialEq for Layout {
    fn eq(&self, other: &Self) -> bool {
        let shape = |of: &Type| -> Vec<_> {
            of.leaves().iter().map(|leaf| (leaf.path.clone(), leaf.kind, leaf.count)).collect()
        };
        shape(&self.0) == shape(&other.0)
    }
}

/// A value in JSON: a number that JSON does not have becomes its word.
pub fn word_of(number: Scalar) -> Value {
    match value_of(number) {
        Value::Null => number.to_string().into(),
        value => value,
    }
}

/// A value in JSON: a number that JSON does not have becomes null.
fn value_of(number: Scalar) -> Value {
    match number {
        Scalar::Bool(value) => value.into(),
        Scalar::Whole(value) => u64::try_from(value)
            .map(Value::from)
            .or_else(|_| i64::try_from(value).map(Value::from))
            .unwrap_or_default(),
        // As it is written, not as the nearest number of twice the digits.
        Scalar::Single(value) => value.to_string().parse::<f64>().map(Value::from).unwrap_or_default(),
        Scalar::Real(value) => value.into(),
    }
}

impl Layout {
    /// Reads the schema of the type `name`; `None` if it holds something that has no fixed length, or a message that is longer than
    /// any.
    pub fn parse(name: &str, schema: &str) -> Option<Self> {
        Type::from_schema(name, schema).ok().map(Self)
    }

    /// The type.
    pub fn message(&self) -> &Type {
        &self.0
    }

    /// The schema from which it was read.
    pub fn definition(&self) -> String {
        self.0.schema()
    }

    /// Bytes of a message.
    pub fn size(&self) -> usize {
        self.0.size()
    }

    /// A column for each value: `name`, or `name[0]`, `name[1]`, ….
    pub fn columns(&self) -> Vec<String> {
        self.0.columns().collect()
    }

    /// The values with their names; `None` if the bytes are not of this layout.
    pub fn json(&self, bytes: &[u8]) -> Option<Map<String, Value>> {
        (bytes.len() == self.size()).then(|| values(&self.0, bytes, value_of))
    }

    /// Appends the values to a line, each after a comma; false: the bytes are not of this layout.
    pub fn cells(&self, bytes: &[u8], line: &mut String) -> bool {
        let Some(numbers) = self.numbers(bytes) else { return false };
        for number in numbers {
            let _ = write!(line, ",{number}"); // to a string: it cannot fail
        }
        true
    }

    /// The values, in the order of [`Layout::columns`]; `None` if the bytes are not of this layout.
    pub fn numbers<'a>(&'a self, bytes: &'a [u8]) -> Option<impl Iterator<Item = Scalar> + 'a> {
        self.0.numbers(bytes)
    }

    /// A JSON schema of [`Layout::json`].
    pub fn json_schema(&self, title: &str) -> Value {
        let mut schema = schema_of(&self.0);
        schema["title"] = title.into();
        schema
    }
}

/// The values of a message with their names, those of types within it in objects of their own; null where the bytes end before.
pub fn values(of: &Type, bytes: &[u8], number: fn(Scalar) -> Value) -> Map<String, Value> {
    let value = |member: &bateleur_messages::format::Member| {
        let each = |element: usize| match &member.body {
            Body::Plain(kind) => {
                let bytes = bytes.get(member.offset + element * kind.size()..).unwrap_or_default();
                Scalar::read(*kind, bytes).map_or(Value::Null, number)
            }
            Body::Nested(nested) => {
                let bytes = bytes.get(member.offset + element * nested.size()..).unwrap_or_default();
                values(nested, bytes, number).into()
            }
        };
        match member.count {
            None => each(0),
            Some(count) => (0..count).map(each).collect::<Vec<_>>().into(),
        }
    };
    of.members().iter().map(|member| (member.name.clone(), value(member))).collect()
}

fn schema_of(of: &Type) -> Value {
    let number = |kind: FieldKind| match kind {
        FieldKind::F32 | FieldKind::F64 => json!({ "type": ["number", "null"] }),
        FieldKind::Bool => json!({ "type": "boolean" }),
        kind if kind.range().is_some_and(|(lowest, _)| lowest == 0) => {
            json!({ "type": "integer", "minimum": 0 })
        }
        _ => json!({ "type": "integer" }),
    };
    let member = |member: &bateleur_messages::format::Member| {
        let one = match &member.body {
            Body::Plain(kind) => number(*kind),
            Body::Nested(nested) => schema_of(nested),
        };
        let of = match member.count {
            None => one,
            Some(count) => json!({ "type": "array", "items": one, "minItems": count, "maxItems": count }),
        };
        (member.name.clone(), of)
    };
    let properties: Map<_, _> = of.members().iter().map(member).collect();
    let names: Vec<_> = of.members().iter().map(|member| member.name.clone()).collect();
    json!({ "type": "object", "properties": properties, "required": names })
}

#[cfg(test)]
mod tests {
    use super::*;
    use bateleur_messages::{State, catalogue};
    use zerocopy::IntoBytes;

    #[test]
    fn schema_of_every_message_is_read_back_as_it_lies() {
        for message in catalogue().types() {
            let layout = Layout::parse(message.name(), &message.schema()).unwrap();
            assert_eq!(layout.message(), &**message);
        }
    }

    #[test]
    fn values_come_out_by_name() {
        let layout = Layout(Type::clone(bateleur_messages::find("State").unwrap()));
        let state = State { valid_ns: 7, position_ned_m: [1.5, -2.0, f64::NAN], ..State::default() };
        let json = layout.json(state.as_bytes()).unwrap();
        assert_eq!(json["valid_ns"], 7);
        assert_eq!(json["position_ned_m"], json!([1.5, -2.0, null]));
        let mut line = String::new();
        assert!(layout.cells(state.as_bytes(), &mut line));
        assert_eq!(line.matches(',').count(), layout.columns().len());
        assert!(line.contains(",1.5,-2,NaN,"), "{line}");
        assert!(!layout.cells(&[0; 3], &mut line) && layout.json(&[]).is_none());
    }

    #[test]
    fn types_within_types_are_objects() {
        let schema = "bool on\nint8 cold\nuint8[2] reserved\nfloat32 share\nacme/Echo[2] echoes\n===\nMSG: acme/Echo\nint16 range\n";
        let layout = Layout::parse("T", schema).unwrap();
        let bytes = [1, 0xff, 0, 0, 0xcd, 0xcc, 0xcc, 0x3d, 2, 0, 0xfe, 0xff];
        let json = layout.json(&bytes).unwrap();
        let (echoes, cold) = (json!([{ "range": 2 }, { "range": -2 }]), json!(-1));
        assert_eq!((&json["echoes"], &json["cold"], &json["on"]), (&echoes, &cold, &json!(true)));
        assert_eq!(json["share"], 0.1, "a float32 keeps its digits");
        let mut line = String::new();
        assert!(layout.cells(&bytes, &mut line));
        assert_eq!(line, ",true,-1,0,0,0.1,2,-2");
        assert_eq!(layout.columns()[5..], ["echoes[0].range", "echoes[1].range"]);
        let schema = layout.json_schema("T");
        assert_eq!(schema["properties"]["echoes"]["items"]["properties"]["range"]["type"], "integer");
    }

    #[test]
    fn layouts_are_equal_where_bytes_mean_the_same() {
        let parse = |schema| Layout::parse("T", schema).unwrap();
        assert_eq!(parse("uint8 a # [m] A height."), parse("uint8 a"));
        assert_ne!(parse("uint8 a"), parse("uint8 b"));
        assert_ne!(parse("uint8 a"), parse("int8 a"));
    }

    #[test]
    fn strange_definitions_are_refused() {
        for strange in [
            "string name",
            "uint8[x] data",
            "float64",
            "uint64[18446744073709551615] all",
            "std_msgs/Header h",
            "# nothing",
            "uint8[2000000000] x",
        ] {
            assert_eq!(Layout::parse("T", strange), None, "{strange}");
        }
    }
}
