//! The objects of one class, by name and by place.

use crate::health::{Notice, Notices};
use crate::return_code::ReturnCode;
use crate::standard::Name;

#[derive(Debug)]
pub(crate) struct Objects<T> {
    items: Vec<(Name, T)>,
    most: usize,
}

impl<T> Objects<T> {
    pub(crate) fn new(most: usize) -> Self {
        Self { items: Vec::new(), most }
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = &T> {
        self.items.iter().map(|(_, item)| item)
    }

    pub(crate) fn len(&self) -> usize {
        self.items.len()
    }

    pub(crate) fn at(&self, place: usize) -> Option<&T> {
        self.items.get(place).map(|(_, item)| item)
    }

    /// The one that an identifier stands for.
    pub(crate) fn get(&self, place: Option<usize>) -> Result<&T, ReturnCode> {
        place.and_then(|place| self.at(place)).ok_or(ReturnCode::InvalidParam)
    }

    /// As above, to change it.
    pub(crate) fn get_mut(&mut self, place: Option<usize>) -> Result<&mut T, ReturnCode> {
        let item = place.and_then(|place| self.items.get_mut(place));
        item.map(|(_, item)| item).ok_or(ReturnCode::InvalidParam)
    }

    /// The place of the one with this name.
    pub(crate) fn find(&self, name: &str) -> Result<usize, ReturnCode> {
        let name = Name::new(name);
        let place = self.items.iter().position(|(known, _)| Some(*known) == name);
        place.ok_or(ReturnCode::InvalidConfig)
    }

    /// The name for a new one: there is space for it, and no other has the name.
    pub(crate) fn new_name(&self, name: &str, notices: &mut Notices) -> Result<Name, ReturnCode> {
        if self.items.len() >= self.most {
            return Err(ReturnCode::InvalidConfig);
        }
        let name = Name::new(name).ok_or(ReturnCode::InvalidParam)?;
        let Some((known, _)) = self.items.iter().find(|(known, _)| *known == name) else { return Ok(name) };
        if !known.is_exactly(&name) {
            notices.add(Notice::SameNameButCase { name });
        }
        Err(ReturnCode::NoAction)
    }

    /// As above, for a new one that has to be in the plan, which has none with a name that is none.
    pub(crate) fn new_planned_name(&self, name: &str, notices: &mut Notices) -> Result<Name, ReturnCode> {
        self.new_name(name, notices).map_err(|code| match code {
            ReturnCode::InvalidParam => ReturnCode::InvalidConfig,
            other => other,
        })
    }

    /// The place of the new one.
    pub(crate) fn add(&mut self, name: Name, item: T) -> usize {
        self.items.push((name, item));
        self.items.len() - 1
    }
}
