//! How a type lies in memory: as `repr(C)` lays it, without a hole.

use std::sync::Arc;

use crate::field::{FieldKind, digest, line};
use crate::syntax::Constant;

/// A type with everything that it is made of.
#[derive(Debug, Clone, PartialEq)]
pub struct Type {
    pub(crate) name: String,
    pub(crate) text: String,
    pub(crate) size: usize,
    pub(crate) align: usize,
    pub(crate) depth: usize,
    pub(crate) members: Vec<Member>,
    pub(crate) constants: Vec<Constant>,
    pub(crate) leaves: Vec<Leaf>,
}

/// A field of a type, as its text has it.
#[derive(Debug, Clone, PartialEq)]
pub struct Member {
    /// Its name.
    pub name: String,
    /// What it is made of.
    pub body: Body,
    /// Elements; `None`: a plain value.
    pub count: Option<usize>,
    /// Bytes from the start of the type.
    pub offset: usize,
    /// The unit of its values; empty: none is given.
    pub unit: String,
    /// What the names of the constants begin with that are its values.
    pub choices: Option<String>,
    /// What it means.
    pub text: String,
}

/// What an element of a field is.
#[derive(Debug, Clone, PartialEq)]
pub enum Body {
    /// A number.
    Plain(FieldKind),
    /// Another type.
    Nested(Arc<Type>),
}

impl Body {
    pub(crate) fn size(&self) -> usize {
        match self {
            Self::Plain(kind) => kind.size(),
            Self::Nested(nested) => nested.size,
        }
    }

    pub(crate) fn align(&self) -> usize {
        match self {
            Self::Plain(kind) => kind.size(),
            Self::Nested(nested) => nested.align,
        }
    }
}

/// An entry of the field table: numbers of one kind, one behind the other.
#[derive(Debug, Clone, PartialEq)]
pub struct Leaf {
    /// Its path, such as `points[2].height`.
    pub path: String,
    /// The unit of its values; empty: none is given.
    pub unit: String,
    /// The kind of each element.
    pub kind: FieldKind,
    /// Elements; `None`: a plain value.
    pub count: Option<usize>,
    /// Bytes from the start of the message.
    pub offset: usize,
    /// The names of its values, without what is common to them.
    pub choices: Arc<[(String, i128)]>,
}

impl Leaf {
    /// Elements, 1 for a plain value.
    #[must_use]
    pub fn elements(&self) -> usize {
        self.count.unwrap_or(1)
    }

    /// The name of a value; `None` where it has none.
    #[must_use]
    pub fn choice(&self, value: crate::Scalar) -> Option<&str> {
        let crate::Scalar::Whole(value) = value else { return None };
        self.choices.iter().find(|(_, number)| *number == value).map(|(name, _)| name.as_str())
    }
}

impl Type {
    /// Its name in full: `Name`, or `package/Name`.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// What it is for.
    #[must_use]
    pub fn text(&self) -> &str {
        &self.text
    }

    /// Bytes of a message.
    #[must_use]
    pub fn size(&self) -> usize {
        self.size
    }

    /// Its alignment, bytes.
    #[must_use]
    pub fn align(&self) -> usize {
        self.align
    }

    /// The fields in the order of their bytes.
    #[must_use]
    pub fn members(&self) -> &[Member] {
        &self.members
    }

    /// The constants in the order of the text.
    #[must_use]
    pub fn constants(&self) -> &[Constant] {
        &self.constants
    }

    /// The field table.
    #[must_use]
    pub fn leaves(&self) -> &[Leaf] {
        &self.leaves
    }

    /// The same number as [`crate::layout_of`] the fields of a program with this type.
    #[must_use]
    pub fn layout(&self) -> u32 {
        let each = |leaf: &'_ Leaf| (leaf.kind, leaf.elements(), leaf.offset);
        digest(self.leaves.iter().map(|leaf| {
            let (kind, count, offset) = each(leaf);
            (leaf.path.as_str(), leaf.unit.as_str(), kind, count, offset)
        }))
    }

    /// The field table for a person, as [`crate::describe`] writes it.
    #[must_use]
    pub fn describe(&self) -> String {
        let line = |leaf: &Leaf| line(&leaf.path, &leaf.unit, leaf.kind, leaf.elements(), leaf.offset);
        self.leaves.iter().map(line).collect()
    }

    /// The names of the values of a field, without what is common to them.
    pub(crate) fn choices_of(constants: &[Constant], prefix: &str) -> Arc<[(String, i128)]> {
        let named = constants.iter().filter_map(|constant| {
            let name = constant.name.strip_prefix(prefix)?.strip_prefix('_')?;
            match constant.value {
                crate::Scalar::Whole(value) => Some((name.to_owned(), value)),
                _ => None,
            }
        });
        named.collect()
    }
}
