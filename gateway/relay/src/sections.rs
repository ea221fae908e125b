//! What two relays whose plans differ tell each other: digests of the parts, so that each can name those that differ.

use bateleur_contract::PortKind;
use bateleur_contract::relay::{LinkTable, RelayTable};

/// Bytes of a part's digest: it names a difference, and protects nothing.
const DIGEST: usize = 8;
/// Longer names are cut, bytes.
const NAME: usize = 80;
/// Bytes of the mark behind parts of which some did not fit: a part without a name.
const MARK: usize = 1 + DIGEST;
/// Names in a message to the operator, which is short.
const NAMED: usize = 3;

/// A part of the plan.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
struct Section {
    name: String,
    digest: [u8; DIGEST],
}

impl Section {
    fn new(name: impl Into<String>, content: &str) -> Self {
        let mut name: String = name.into();
        while name.len() > NAME {
            name.pop();
        }
        let hash = blake3::hash(content.as_bytes());
        let mut digest = [0; DIGEST];
        digest.copy_from_slice(&hash.as_bytes()[..DIGEST]);
        Self { name, digest }
    }
}

/// The parts of this end's plan that a link knows of.
pub(crate) struct Sections(Vec<Section>);

impl Sections {
    /// What `link` rests on, and what the executive named beside it. Both ends make the same of the same plan.
    pub(crate) fn new(table: &RelayTable, link: &LinkTable) -> Self {
        let mut parts: Vec<Section> =
            table.sections.iter().map(|(name, digest)| Section::new(name.as_str(), digest)).collect();
        let mut modules = [table.module.as_str(), link.peer.as_str()];
        modules.sort_unstable();
        parts.push(Section::new("modules of the link", &modules.join("\n")));
        parts.push(Section::new("link.gap", &link.gap_ns.to_string()));
        parts.push(Section::new("link.max_bytes", &link.max_datagram.to_string()));
        parts.push(Section::new("link.skew", &link.skew_ns.to_string()));
        let networks: Vec<&str> = link.paths.iter().map(|path| path.network.as_str()).collect();
        parts.push(Section::new("link.networks", &networks.join("\n")));
        for channel in &link.channels {
            let kind = match channel.kind {
                PortKind::Sampling => "sampling",
                PortKind::Queuing => "queuing",
            };
            let of_initiator = channel.outgoing == link.initiator;
            let content =
                format!("{} {kind} {} {} {of_initiator}", channel.id, channel.max_bytes, channel.depth);
            parts.push(Section::new(format!("channel {}", channel.name), &content));
        }
        parts.sort();
        Self(parts)
    }

    /// Appends as many parts as fit into `room` bytes, the first ones in their order, and a mark where those are not all; gives the
    /// number of what was appended.
    pub(crate) fn put(&self, datagram: &mut Vec<u8>, room: usize) -> u16 {
        let length = |part: &Section| 1 + part.name.len() + DIGEST;
        let whole = self.0.iter().map(length).sum::<usize>() <= room;
        let end = datagram.len() + if whole { room } else { room.saturating_sub(MARK) };
        let mut count = 0;
        for part in &self.0 {
            if datagram.len() + length(part) > end {
                break;
            }
            datagram.push(part.name.len() as u8); // at most NAME
            datagram.extend_from_slice(part.name.as_bytes());
            datagram.extend_from_slice(&part.digest);
            count += 1;
        }
        if !whole && room >= MARK {
            datagram.extend_from_slice(&[0; MARK]);
            count += 1;
        }
        count
    }

    /// What differs from the peer's parts, in words; nothing where the bytes are not those of parts.
    pub(crate) fn compare(&self, bytes: &[u8], count: u16) -> Option<String> {
        let mut theirs = read(bytes, count)?;
        // What stands behind the last that fitted is not known to be absent.
        let cut = theirs.pop_if(|part| part.name.is_empty()).is_some();
        let end = theirs.last().filter(|_| cut).map(|last| last.name.clone());
        let told = |part: &Section| end.as_ref().is_none_or(|end| part.name <= *end);
        let other = |part: &Section| theirs.iter().find(|theirs| theirs.name == part.name);
        let differing = |part: &&Section| other(part).is_some_and(|theirs| theirs.digest != part.digest);
        let names = |parts: &[&Section]| {
            let mut text: Vec<&str> = parts.iter().take(NAMED).map(|part| part.name.as_str()).collect();
            if parts.len() > NAMED {
                text.push("and more");
            }
            text.join(", ")
        };
        let differ: Vec<&Section> = self.0.iter().filter(differing).collect();
        let here: Vec<&Section> = self.0.iter().filter(|part| other(part).is_none() && told(part)).collect();
        let there: Vec<&Section> =
            theirs.iter().filter(|part| !self.0.iter().any(|own| own.name == part.name)).collect();
        let mut said = Vec::new();
        for (what, parts) in [("differs in", differ), ("only here", here), ("only there", there)] {
            if !parts.is_empty() {
                said.push(format!("{what}: {}", names(&parts)));
            }
        }
        Some(match (said.is_empty(), cut) {
            (false, _) => said.join("; "),
            (true, false) => "differs beyond this link".into(),
            (true, true) => "differs in a part for which a datagram has no room".into(),
        })
    }
}

fn read(mut bytes: &[u8], count: u16) -> Option<Vec<Section>> {
    let mut sections = Vec::new();
    for _ in 0..count {
        let (length, rest) = bytes.split_first()?;
        let (name, rest) = rest.split_at_checked(usize::from(*length))?;
        let (digest, rest) = rest.split_first_chunk::<DIGEST>()?;
        let name = std::str::from_utf8(name).ok()?.to_owned();
        // It is shown to an operator: nothing that a terminal would obey.
        if name.chars().any(char::is_control) {
            return None;
        }
        sections.push(Section { name, digest: *digest });
        bytes = rest;
    }
    bytes.is_empty().then_some(sections)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Parts `a0` to `a9` whose digests are those of the words.
    fn parts(words: &[&str]) -> Sections {
        let part = |(number, word): (usize, &&str)| Section::new(format!("a{number}"), word);
        Sections(words.iter().enumerate().map(part).collect())
    }

    fn told(from: &Sections, to: &Sections, room: usize) -> String {
        let mut datagram = vec![7; 3];
        let count = from.put(&mut datagram, room);
        assert!(datagram.len() <= 3 + room);
        to.compare(&datagram[3..], count).unwrap()
    }

    #[test]
    fn part_that_had_no_room_in_the_datagram_is_not_told_as_a_difference() {
        let (here, there) = (parts(&["x", "y", "z", "u", "v"]), parts(&["x", "w", "z", "u", "v"]));
        let whole = 5 * (1 + 2 + DIGEST);
        for room in [whole, whole - 1, 3 * (1 + 2 + DIGEST) + MARK] {
            assert_eq!(told(&there, &here, room), "differs in: a1", "{room}");
        }
        let last = parts(&["x", "y", "z", "u", "other"]);
        assert_eq!(told(&last, &here, whole), "differs in: a4");
        let expected = "differs in a part for which a datagram has no room";
        assert_eq!(told(&last, &here, whole - 1), expected);
    }

    #[test]
    fn part_that_only_one_end_has_is_told_where_the_order_shows_it() {
        let (more, less) =
            (parts(&["x", "y", "z"]), Sections(vec![Section::new("a0", "x"), Section::new("a2", "z")]));
        assert_eq!(told(&less, &more, 100), "only here: a1");
        assert_eq!(told(&more, &less, 100), "only there: a1");
    }
}
