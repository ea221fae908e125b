//! Values of a message by the names of its fields.

use crate::field::FieldKind;
use crate::layout::{Body, Leaf, Member, Type};
use crate::scalar::Scalar;
use crate::words;

/// Where one number of a message lies.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place<'a> {
    /// The field that it belongs to.
    pub member: &'a Member,
    /// Its kind.
    pub kind: FieldKind,
    /// Bytes from the start of the message.
    pub offset: usize,
}

/// A path that leads to no number.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PathError {
    /// No such field.
    #[error("{of} has no field {field}{hint}")]
    NoField {
        /// The type.
        of: String,
        /// What was asked for.
        field: String,
        /// What may have been meant.
        hint: String,
    },
    /// An array without an index, or an index that there is not.
    #[error("{field} of {of} has {count} elements: write {field}[0], and so on")]
    Index {
        /// The type.
        of: String,
        /// The field.
        field: String,
        /// Its elements.
        count: usize,
    },
    /// It ends at a type.
    #[error("{field} of {of} is a {inner}: write one of its fields behind it, such as {field}.{first}")]
    NotPlain {
        /// The type.
        of: String,
        /// The field.
        field: String,
        /// The field's type.
        inner: String,
        /// A field of that one.
        first: String,
    },
    /// It goes on behind a number.
    #[error("{field} of {of} is a number, with nothing in it")]
    Plain {
        /// The type.
        of: String,
        /// The field.
        field: String,
    },
}

impl Type {
    /// The number that a path such as `points[2].height` leads to.
    ///
    /// # Errors
    /// It leads to none.
    pub fn place(&self, path: &str) -> Result<Place<'_>, PathError> {
        let (step, rest) = path.split_once('.').map_or((path, None), |(step, rest)| (step, Some(rest)));
        let (name, index) = match step.split_once('[') {
            Some((name, index)) => (name, Some(index.strip_suffix(']').and_then(|index| index.parse().ok()))),
            None => (step, None),
        };
        let Some(member) = self.members.iter().find(|member| member.name == name) else {
            let near = words::nearest(name, self.members.iter().map(|member| member.name.as_str()));
            let hint = near.map_or(String::new(), |near| format!("; did you mean {near}?"));
            return Err(PathError::NoField { of: self.name.clone(), field: name.to_owned(), hint });
        };
        let (of, field) = (self.name.clone(), member.name.clone());
        let count = member.count.unwrap_or(1);
        let element: Option<usize> = match index {
            None if member.count.is_none() => Some(0),
            None => None,
            Some(index) => index.filter(|index| *index < count),
        };
        let Some(element) = element else { return Err(PathError::Index { of, field, count }) };
        let offset = member.offset + element * member.body.size();
        match (&member.body, rest) {
            (Body::Plain(kind), None) => Ok(Place { member, kind: *kind, offset }),
            (Body::Plain(_), Some(_)) => Err(PathError::Plain { of, field }),
            (Body::Nested(nested), Some(rest)) => {
                nested.place(rest).map(|place| Place { offset: offset + place.offset, ..place })
            }
            (Body::Nested(nested), None) => {
                let first = nested.members.first().map_or(String::new(), |first| first.name.clone());
                Err(PathError::NotPlain { of, field, inner: nested.name.clone(), first })
            }
        }
    }

    /// The number at `path` of a message.
    ///
    /// # Errors
    /// The path leads to none.
    pub fn get(&self, message: &[u8], path: &str) -> Result<Option<Scalar>, PathError> {
        let place = self.place(path)?;
        Ok(message.get(place.offset..).and_then(|bytes| Scalar::read(place.kind, bytes)))
    }

    /// Writes the number at `path` of a message. `None`: its kind does not hold the value, or the message is too short.
    ///
    /// # Errors
    /// The path leads to no number.
    pub fn set(&self, message: &mut [u8], path: &str, value: Scalar) -> Result<Option<()>, PathError> {
        let place = self.place(path)?;
        Ok(message.get_mut(place.offset..).and_then(|bytes| value.write(place.kind, bytes)))
    }

    /// The numbers of a message in the order of their bytes; `None` if the bytes are not as many as the type has.
    pub fn numbers<'a>(&'a self, message: &'a [u8]) -> Option<impl Iterator<Item = Scalar> + 'a> {
        let numbers = move |leaf: &'a Leaf| leaf.numbers(message);
        (message.len() == self.size).then(|| self.leaves.iter().flat_map(numbers))
    }

    /// The paths of [`Type::numbers`].
    pub fn columns(&self) -> impl Iterator<Item = String> + '_ {
        self.leaves.iter().flat_map(|leaf| {
            let path = |element: usize| match leaf.count {
                None => leaf.path.clone(),
                Some(_) => format!("{}[{element}]", leaf.path),
            };
            (0..leaf.elements()).map(path)
        })
    }
}

impl Leaf {
    /// Its numbers in a message, as far as the bytes go.
    pub fn numbers<'a>(&'a self, message: &'a [u8]) -> impl Iterator<Item = Scalar> + 'a {
        let number = |element: usize| {
            let bytes = message.get(self.offset + element * self.kind.size()..)?;
            Scalar::read(self.kind, bytes)
        };
        (0..self.elements()).map_while(number)
    }
}
