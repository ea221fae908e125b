//! How the values of a message lie in its bytes, read from the schema that the log itself carries: a log can be taken
//! apart by a build that does not know its messages.

use serde_json::{Map, Value};

/// Bytes that a layout may describe: eight times the longest message that a port may have. Each value takes a name and a cell
/// where it is compared or exported, so that a few letters of a foreign schema could ask for all memory.
const LONGEST: usize = 64 << 10;

/// The fields of a message, in the order of their bytes.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Layout {
    fields: Vec<Laid>,
    size: usize,
}

/// One field.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Laid {
    name: String,
    kind: Kind,
    /// Elements; `None`: a plain value.
    count: Option<usize>,
    offset: usize,
}

/// One value of a message.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Number {
    /// Of a field that counts.
    Whole(u64),
    /// Of a field that measures.
    Real(f64),
}

impl Number {
    /// The same bits.
    pub fn is_same(self, other: Self) -> bool {
        match (self, other) {
            (Self::Whole(a), Self::Whole(b)) => a == b,
            (Self::Real(a), Self::Real(b)) => a.to_bits() == b.to_bits(),
            _ => false,
        }
    }

    /// `other` minus this one.
    pub fn difference(self, other: Self) -> f64 {
        match (self, other) {
            (Self::Whole(a), Self::Whole(b)) => i128::from(b).wrapping_sub(i128::from(a)) as f64,
            (a, b) => b.real() - a.real(),
        }
    }

    fn real(self) -> f64 {
        match self {
            Self::Whole(value) => value as f64,
            Self::Real(value) => value,
        }
    }
}

/// The shortest text that reads back as the same number.
impl std::fmt::Display for Number {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Whole(value) => write!(f, "{value}"),
            Self::Real(value) => write!(f, "{value}"),
        }
    }
}

impl From<Number> for Value {
    /// A number that JSON does not have becomes its word.
    fn from(number: Number) -> Self {
        match number {
            Number::Whole(value) => value.into(),
            Number::Real(value) if value.is_finite() => value.into(),
            Number::Real(value) => value.to_string().into(),
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    U8,
    U16,
    U32,
    U64,
    F64,
}

impl Kind {
    fn named(name: &str) -> Option<Self> {
        match name {
            "uint8" => Some(Self::U8),
            "uint16" => Some(Self::U16),
            "uint32" => Some(Self::U32),
            "uint64" => Some(Self::U64),
            "float64" => Some(Self::F64),
            _ => None,
        }
    }

    const fn name(self) -> &'static str {
        match self {
            Self::U8 => "uint8",
            Self::U16 => "uint16",
            Self::U32 => "uint32",
            Self::U64 => "uint64",
            Self::F64 => "float64",
        }
    }

    const fn size(self) -> usize {
        match self {
            Self::U8 => 1,
            Self::U16 => 2,
            Self::U32 => 4,
            Self::U64 | Self::F64 => 8,
        }
    }

    /// The value at the start of `bytes`, which are long enough.
    fn read(self, bytes: &[u8]) -> Value {
        match self.number(bytes) {
            // A number that JSON does not have becomes null.
            Number::Real(value) => value.into(),
            Number::Whole(value) => value.into(),
        }
    }

    /// As [`Kind::read`].
    fn number(self, bytes: &[u8]) -> Number {
        let mut eight = [0; 8];
        eight[..self.size()].copy_from_slice(&bytes[..self.size()]);
        match self {
            Self::F64 => Number::Real(f64::from_le_bytes(eight)),
            _ => Number::Whole(u64::from_le_bytes(eight)),
        }
    }

    fn write(self, bytes: &[u8], out: &mut String) {
        use std::fmt::Write as _;
        let _ = write!(out, "{}", self.number(bytes)); // to a string: it cannot fail
    }
}

impl Layout {
    /// Reads a definition in ROS 2's language, as far as the log uses it; `None` if it holds something else, nothing at all, or a
    /// message that is longer than any.
    pub fn parse(definition: &str) -> Option<Self> {
        let mut layout = Self::default();
        for line in
            definition.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with('#'))
        {
            let (kind, name) = line.split_once(' ')?;
            let (kind, count) = match kind.strip_suffix(']').and_then(|kind| kind.split_once('[')) {
                Some((kind, count)) => (kind, Some(count.parse::<usize>().ok()?)),
                None => (kind, None),
            };
            let kind = Kind::named(kind)?;
            layout.fields.push(Laid { name: name.trim().to_owned(), kind, count, offset: layout.size });
            layout.size = kind.size().checked_mul(count.unwrap_or(1))?.checked_add(layout.size)?;
        }
        (1..=LONGEST).contains(&layout.size).then_some(layout)
    }

    /// The definition from which it was read, in its shortest form.
    pub fn definition(&self) -> String {
        let line = |field: &Laid| {
            let array = field.count.map_or_else(String::new, |count| format!("[{count}]"));
            format!("{}{array} {}\n", field.kind.name(), field.name)
        };
        self.fields.iter().map(line).collect()
    }

    /// Bytes of a message.
    pub fn size(&self) -> usize {
        self.size
    }

    /// A column for each value: `name`, or `name[0]`, `name[1]`, ….
    pub fn columns(&self) -> Vec<String> {
        let of = |field: &Laid| match field.count {
            None => vec![field.name.clone()],
            Some(count) => (0..count).map(|place| format!("{}[{place}]", field.name)).collect(),
        };
        self.fields.iter().flat_map(of).collect()
    }

    /// The values with their names; `None` if the bytes are not of this layout.
    pub fn json(&self, bytes: &[u8]) -> Option<Map<String, Value>> {
        let values = |field: &Laid| {
            let each = |place: usize| field.kind.read(&bytes[field.offset + place * field.kind.size()..]);
            match field.count {
                None => each(0),
                Some(count) => (0..count).map(each).collect::<Vec<_>>().into(),
            }
        };
        let all = || self.fields.iter().map(|field| (field.name.clone(), values(field))).collect();
        (bytes.len() == self.size).then(all)
    }

    /// Appends the values to a line, each after a comma; false: the bytes are not of this layout.
    pub fn cells(&self, bytes: &[u8], line: &mut String) -> bool {
        if bytes.len() != self.size {
            return false;
        }
        for field in &self.fields {
            for place in 0..field.count.unwrap_or(1) {
                line.push(',');
                field.kind.write(&bytes[field.offset + place * field.kind.size()..], line);
            }
        }
        true
    }

    /// The values, in the order of [`Layout::columns`]; `None` if the bytes are not of this layout.
    pub fn numbers<'a>(&'a self, bytes: &'a [u8]) -> Option<impl Iterator<Item = Number> + 'a> {
        let of = move |field: &'a Laid| {
            let place = move |index: usize| field.offset + index * field.kind.size();
            (0..field.count.unwrap_or(1)).map(move |index| field.kind.number(&bytes[place(index)..]))
        };
        (bytes.len() == self.size).then(|| self.fields.iter().flat_map(of))
    }

    /// A JSON schema of [`Layout::json`].
    pub fn json_schema(&self, title: &str) -> Value {
        let number = |kind: Kind| match kind {
            Kind::F64 => serde_json::json!({ "type": ["number", "null"] }),
            _ => serde_json::json!({ "type": "integer", "minimum": 0 }),
        };
        let of = |field: &Laid| match field.count {
            None => number(field.kind),
            Some(count) => serde_json::json!({
                "type": "array", "items": number(field.kind), "minItems": count, "maxItems": count,
            }),
        };
        let properties: Map<_, _> = self.fields.iter().map(|field| (field.name.clone(), of(field))).collect();
        let names: Vec<_> = self.fields.iter().map(|field| field.name.clone()).collect();
        serde_json::json!({ "title": title, "type": "object", "properties": properties, "required": names })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bateleur_messages::{CATALOGUE, State};
    use zerocopy::IntoBytes;

    #[test]
    fn definition_of_every_message_is_read_back_as_it_lies() {
        for message in CATALOGUE {
            let definition = crate::write::definition(message.fields);
            let layout = Layout::parse(&definition).unwrap();
            assert_eq!((layout.size(), layout.definition()), (message.size, definition), "{}", message.name);
            for (laid, field) in layout.fields.iter().zip(message.fields) {
                assert_eq!((laid.name.as_str(), laid.offset), (field.name, field.offset), "{}", message.name);
            }
        }
    }

    #[test]
    fn values_come_out_by_name() {
        let fields = <State as bateleur_messages::Message>::FIELDS;
        let layout = Layout::parse(&crate::write::definition(fields)).unwrap();
        let state = State { valid_ns: 7, position_ned_m: [1.5, -2.0, f64::NAN], ..State::default() };
        let json = layout.json(state.as_bytes()).unwrap();
        assert_eq!(json["valid_ns"], 7);
        assert_eq!(json["position_ned_m"], serde_json::json!([1.5, -2.0, null]));
        let mut line = String::new();
        assert!(layout.cells(state.as_bytes(), &mut line));
        assert_eq!(line.matches(',').count(), layout.columns().len());
        assert!(line.contains(",1.5,-2,NaN,"), "{line}");
        assert!(!layout.cells(&[0; 3], &mut line) && layout.json(&[]).is_none());
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
        ] {
            assert_eq!(Layout::parse(strange), None, "{strange}");
        }
        assert_eq!(Layout::parse("# a comment\n\nuint8 one\n").unwrap().columns(), ["one"]);
    }

    #[test]
    fn definition_of_a_message_that_is_longer_than_any_is_refused_before_memory_is_asked_for() {
        assert!(Layout::parse("uint8[8192] x\n").is_some());
        assert_eq!(Layout::parse("uint8[2000000000] x\n"), None);
        assert_eq!(Layout::parse(&"uint64[4096] x\n".repeat(3)), None);
    }
}
