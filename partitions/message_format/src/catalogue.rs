//! Types that know each other: names are looked up, cycles refused, bytes laid out.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use crate::bounds;
use crate::fault::{Fault, Faults, Reporter, Spot};
use crate::layout::{Body, Leaf, Member, Type};
use crate::syntax::{self, Definition, FieldLine, Reference};
use crate::words;

/// The text of one type.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Source {
    /// The type's name in full: `Name`, or `package/Name`.
    pub name: String,
    /// What errors call the text.
    pub file: String,
    /// The text.
    pub text: String,
}

/// Types by their names.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Catalogue {
    types: BTreeMap<String, Arc<Type>>,
}

impl Catalogue {
    /// Reads the types of `sources`. Two of one name are refused, unless they say the same.
    ///
    /// # Errors
    /// Everything that is wrong with them.
    pub fn read(sources: impl IntoIterator<Item = Source>) -> Result<Self, Faults> {
        let mut resolver = Resolver::default();
        for source in sources {
            resolver.parse(&source);
        }
        let names: Vec<String> = resolver.definitions.keys().cloned().collect();
        for name in names {
            resolver.resolve(&name);
        }
        match resolver.faults.is_empty() {
            true => Ok(Self { types: resolver.types }),
            false => Err(Faults(resolver.faults)),
        }
    }

    /// These types and `others`, of which one with a name that is known is left out.
    #[must_use]
    pub fn and(&self, others: impl IntoIterator<Item = Type>) -> Self {
        let mut types = self.types.clone();
        for of in others {
            types.entry(of.name().to_owned()).or_insert_with(|| Arc::new(of));
        }
        Self { types }
    }

    /// The type called `name`, exactly as written.
    #[must_use]
    pub fn find(&self, name: &str) -> Option<&Arc<Type>> {
        self.types.get(name)
    }

    /// All types, by their names.
    pub fn types(&self) -> impl Iterator<Item = &Arc<Type>> {
        self.types.values()
    }
}

#[derive(Default)]
struct Resolver {
    /// By name, with the file's.
    definitions: BTreeMap<String, (String, Definition)>,
    types: BTreeMap<String, Arc<Type>>,
    /// Those that were found wrong.
    wrong: BTreeSet<String>,
    /// Those that are being resolved, each within the one before.
    under_way: Vec<String>,
    faults: Vec<Fault>,
}

/// The head of a file.
const HEAD: Spot = Spot { line: 1, column: 1 };

impl Resolver {
    fn parse(&mut self, source: &Source) {
        let mut report = Reporter { file: &source.file, faults: &mut self.faults };
        let (package, name) = source.name.split_once('/').unwrap_or(("", &source.name));
        let named = words::is_type(name) && source.name.len() <= bounds::NAME_BYTES;
        let free = !words::is_reserved(package) && package != words::PACKAGE;
        if !named || !(package.is_empty() || words::is_field(package) && free) {
            let what = format!("`{}` can not be the name of a type", source.name);
            let mend = "call the file Name.msg, letters and digits with a capital first, in a folder with a name of lower case letters, digits and underscores; at most 60 letters";
            return report.add(HEAD, what, mend);
        }
        if source.text.len() > bounds::FILE_BYTES {
            let what = format!("a text of {} bytes", source.text.len());
            return report.add(HEAD, what, format!("leave at most {}", bounds::FILE_BYTES));
        }
        if self.definitions.len() == bounds::TYPES {
            return report.add(HEAD, format!("more than {} types", bounds::TYPES), "leave some out");
        }
        let definition = syntax::parse(&source.name, &source.text, &mut report);
        match self.definitions.get(&source.name) {
            Some((other, before)) if !says_the_same(before, &definition) => {
                let what = format!("there is a type {} already, with other fields, in {other}", source.name);
                let mend =
                    "rename one of them, or put it into a folder of its own: the folder is part of the name";
                report.add(HEAD, what, mend);
            }
            Some(_) => {}
            None => drop(self.definitions.insert(source.name.clone(), (source.file.clone(), definition))),
        }
    }

    /// The type called so; `None` if there is none that is right.
    fn resolve(&mut self, name: &str) -> Option<Arc<Type>> {
        if let Some(known) = self.types.get(name) {
            return Some(known.clone());
        }
        let (file, definition) = self.definitions.get(name)?.clone();
        if self.wrong.contains(name) {
            return None;
        }
        let before = self.faults.len();
        self.under_way.push(name.to_owned());
        let bodies: Vec<Option<Body>> =
            definition.fields.iter().map(|field| self.body(&file, &definition, field)).collect();
        self.under_way.pop();
        let mut report = Reporter { file: &file, faults: &mut self.faults };
        let laid = bodies.into_iter().collect::<Option<Vec<Body>>>();
        let laid = laid.and_then(|bodies| lay_out(definition, bodies, &mut report));
        match laid {
            Some(laid) if before == self.faults.len() => {
                let laid = Arc::new(laid);
                self.types.insert(name.to_owned(), laid.clone());
                Some(laid)
            }
            _ => {
                self.wrong.insert(name.to_owned());
                None
            }
        }
    }

    fn body(&mut self, file: &str, definition: &Definition, field: &FieldLine) -> Option<Body> {
        let name = match &field.of {
            Reference::Plain(kind) => return Some(Body::Plain(*kind)),
            Reference::Named(name) => name,
        };
        let mut report = Reporter { file, faults: &mut self.faults };
        if let Some(place) = self.under_way.iter().position(|other| other == name) {
            let way = self.under_way[place..].join(", which holds ");
            report.add(field.at, format!("{name} would hold itself: {way}"), "leave one of these fields out");
            return None;
        }
        if self.under_way.len() > bounds::DEPTH {
            let what = format!("more than {} types within each other", bounds::DEPTH);
            report.add(field.at, what, "put the fields of some of them into the others");
            return None;
        }
        if !self.definitions.contains_key(name) {
            let known = self.definitions.keys().map(String::as_str);
            let mend = match words::nearest(name, known) {
                Some(near) => format!("did you mean `{near}`?"),
                None => {
                    let package = words::package_of(&definition.name);
                    let folder = if package.is_empty() { "beside it" } else { "in the same folder" };
                    format!("put its file {folder}, or write `package/Name` for one of another folder")
                }
            };
            report.add(field.at, format!("there is no type `{name}`"), mend);
            return None;
        }
        self.resolve(name).map(Body::Nested)
    }
}

/// Whether two definitions differ at most in their places.
fn says_the_same(one: &Definition, other: &Definition) -> bool {
    let placeless = |definition: &Definition| {
        let mut definition = definition.clone();
        definition.fields.iter_mut().for_each(|field| field.at = Spot::default());
        definition
    };
    placeless(one) == placeless(other)
}

fn lay_out(definition: Definition, bodies: Vec<Body>, report: &mut Reporter<'_>) -> Option<Type> {
    let (mut members, mut leaves) = (Vec::new(), Vec::new());
    let (mut end, mut align, mut depth) = (0_usize, 1, 1);
    for (field, body) in definition.fields.iter().zip(bodies) {
        let (at, to) = (field.at, body.align());
        if !end.is_multiple_of(to) {
            let hole = to - end % to;
            let what = format!("field `{}` would begin at byte {end}, and its alignment is {to}", field.name);
            report.add(at, what, format!("put `{}` above it, or sort the fields", reserved(hole)));
            return None;
        }
        if let Body::Nested(nested) = &body {
            depth = depth.max(nested.depth + 1);
        }
        let choices = choices(&definition, field, report)?;
        let bytes = body.size().checked_mul(field.count.unwrap_or(1));
        let Some(next) =
            bytes.and_then(|bytes| end.checked_add(bytes)).filter(|&next| next <= bounds::MESSAGE_BYTES)
        else {
            let what =
                format!("with `{}` the message is longer than {} bytes", field.name, bounds::MESSAGE_BYTES);
            report.add(at, what, "make an array shorter");
            return None;
        };
        let member = Member {
            name: field.name.clone(),
            body,
            count: field.count,
            offset: end,
            unit: field.notes.unit.clone(),
            choices: field.notes.choices.clone(),
            text: field.notes.text.clone(),
        };
        if !add_leaves(&member, &choices, &mut leaves) {
            let what =
                format!("with `{}` there are more than {} numbers by name", field.name, bounds::LEAVES);
            report.add(at, what, "make an array of types shorter");
            return None;
        }
        members.push(member);
        (end, align) = (next, align.max(to));
    }
    let last = definition.fields.last()?;
    if !end.is_multiple_of(align) {
        let what = format!("{} ends at byte {end}, and its alignment is {align}", definition.name);
        let mend = format!("put `{}` at its end", reserved(align - end % align));
        report.add(last.at, what, mend);
        return None;
    }
    if depth > bounds::DEPTH {
        let what = format!("{} has more than {} types within each other", definition.name, bounds::DEPTH);
        report.add(HEAD, what, "put the fields of some of them into the others");
        return None;
    }
    let Definition { name, text, constants, .. } = definition;
    Some(Type { name, text, size: end, align, depth, members, constants, leaves })
}

fn reserved(bytes: usize) -> String {
    if bytes == 1 { "uint8 reserved".to_owned() } else { format!("uint8[{bytes}] reserved") }
}

type Choices = Arc<[(String, i128)]>;

/// The named values of a field, none where it names no constants; `None`: those that it names are not right.
fn choices(definition: &Definition, field: &FieldLine, report: &mut Reporter<'_>) -> Option<Choices> {
    let Some(prefix) = &field.notes.choices else { return Some(Choices::default()) };
    let Reference::Plain(kind) = field.of else {
        let what = format!("`{}` is of a type, and has the constants {prefix}_… for values", field.name);
        report.add(field.at, what, "bind them to a whole number of that type");
        return None;
    };
    let choices = Type::choices_of(&definition.constants, prefix);
    if choices.is_empty() {
        let what = format!("no whole constant begins with {prefix}_");
        let mend = format!("write one, such as `{} {prefix}_OFF = 0`", kind.ros2_name());
        report.add(field.at, what, mend);
        return None;
    }
    let holds =
        |value: i128| kind.range().is_some_and(|(lowest, highest)| (lowest..=highest).contains(&value));
    if let Some((name, value)) = choices.iter().find(|(_, value)| !holds(*value)) {
        let what =
            format!("{prefix}_{name} = {value} is no value of `{}`, a {}", field.name, kind.ros2_name());
        report.add(field.at, what, "choose another type or another value");
        return None;
    }
    Some(choices)
}

/// Adds the numbers of a member to the table; false: they are too many.
fn add_leaves(member: &Member, choices: &Choices, leaves: &mut Vec<Leaf>) -> bool {
    let nested = match &member.body {
        Body::Plain(kind) => {
            leaves.push(Leaf {
                path: member.name.clone(),
                unit: member.unit.clone(),
                kind: *kind,
                count: member.count,
                offset: member.offset,
                choices: choices.clone(),
            });
            return leaves.len() <= bounds::LEAVES;
        }
        Body::Nested(nested) => nested,
    };
    let elements = member.count.unwrap_or(1);
    if nested.leaves.len().saturating_mul(elements) > bounds::LEAVES - leaves.len().min(bounds::LEAVES) {
        return false;
    }
    for element in 0..elements {
        let index = member.count.map_or(String::new(), |_| format!("[{element}]"));
        leaves.extend(nested.leaves.iter().map(|leaf| Leaf {
            path: format!("{}{index}.{}", member.name, leaf.path),
            offset: member.offset + element * nested.size + leaf.offset,
            ..leaf.clone()
        }));
    }
    true
}
