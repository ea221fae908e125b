//! Lists of processes: the ready ones of each priority, and those that wait at an object.
//!
//! A process is in one list at most, so that each has one pair of links, and leaving a list costs the same wherever it stands.

/// No node, no list.
const NONE: u16 = u16::MAX;

/// One list.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct ListId(u16);

impl ListId {
    /// The list that was made as number `place`.
    pub(crate) fn number(place: usize) -> Self {
        Self(place as u16)
    }
}

#[derive(Debug, Clone, Copy)]
struct List {
    first: u16,
    last: u16,
    length: u16,
}

#[derive(Debug, Clone, Copy)]
struct Node {
    list: u16,
    before: u16,
    after: u16,
    /// What a list by priority is sorted by.
    key: i32,
}

#[derive(Debug)]
pub(crate) struct Queues {
    lists: Vec<List>,
    nodes: Vec<Node>,
    /// How often a process has entered or left a list.
    changes: u64,
}

impl Queues {
    /// With space for so many of both, so that neither grows later.
    pub(crate) fn new(lists: usize, nodes: usize) -> Self {
        Self { lists: Vec::with_capacity(lists), nodes: Vec::with_capacity(nodes), changes: 0 }
    }

    pub(crate) fn add_list(&mut self) -> ListId {
        self.lists.push(List { first: NONE, last: NONE, length: 0 });
        ListId::number(self.lists.len() - 1)
    }

    /// Nodes are numbered from 0.
    pub(crate) fn add_node(&mut self) {
        self.nodes.push(Node { list: NONE, before: NONE, after: NONE, key: 0 });
    }

    pub(crate) fn changes(&self) -> u64 {
        self.changes
    }

    pub(crate) fn first(&self, list: ListId) -> Option<usize> {
        let first = self.lists[list.0 as usize].first;
        (first != NONE).then_some(first as usize)
    }

    pub(crate) fn length(&self, list: ListId) -> i32 {
        i32::from(self.lists[list.0 as usize].length)
    }

    pub(crate) fn is_empty(&self, list: ListId) -> bool {
        self.lists[list.0 as usize].length == 0
    }

    /// The list that a node is in.
    pub(crate) fn list_of(&self, node: usize) -> Option<ListId> {
        let list = self.nodes[node].list;
        (list != NONE).then_some(ListId(list))
    }

    pub(crate) fn push_back(&mut self, list: ListId, node: usize) {
        let last = self.lists[list.0 as usize].last;
        self.link(list, node, last, NONE);
    }

    pub(crate) fn push_front(&mut self, list: ListId, node: usize) {
        let first = self.lists[list.0 as usize].first;
        self.link(list, node, NONE, first);
    }

    /// Behind all whose key is not lower.
    pub(crate) fn push_by_key(&mut self, list: ListId, node: usize, key: i32) {
        self.nodes[node].key = key;
        let mut before = self.lists[list.0 as usize].last;
        let mut after = NONE;
        while before != NONE && self.nodes[before as usize].key < key {
            after = before;
            before = self.nodes[before as usize].before;
        }
        self.link(list, node, before, after);
    }

    /// Takes a node out of its list. It may be in none.
    pub(crate) fn remove(&mut self, node: usize) {
        let Node { list, before, after, .. } = self.nodes[node];
        if list == NONE {
            return;
        }
        self.changes = self.changes.wrapping_add(1);
        let whole = &mut self.lists[list as usize];
        whole.length -= 1;
        if before == NONE {
            whole.first = after;
        } else {
            self.nodes[before as usize].after = after;
        }
        if after == NONE {
            whole.last = before;
        } else {
            self.nodes[after as usize].before = before;
        }
        self.nodes[node].list = NONE;
    }

    fn link(&mut self, list: ListId, node: usize, before: u16, after: u16) {
        self.changes = self.changes.wrapping_add(1);
        let whole = &mut self.lists[list.0 as usize];
        whole.length += 1;
        let place = node as u16;
        if before == NONE {
            whole.first = place;
        } else {
            self.nodes[before as usize].after = place;
        }
        if after == NONE {
            whole.last = place;
        } else {
            self.nodes[after as usize].before = place;
        }
        let key = self.nodes[node].key;
        self.nodes[node] = Node { list: list.0, before, after, key };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn queues(nodes: usize) -> (Queues, ListId) {
        let mut queues = Queues::new(1, nodes);
        (0..nodes).for_each(|_| queues.add_node());
        let list = queues.add_list();
        (queues, list)
    }

    fn drain(queues: &mut Queues, list: ListId) -> Vec<usize> {
        let mut found = Vec::new();
        while let Some(node) = queues.first(list) {
            queues.remove(node);
            found.push(node);
        }
        assert!(queues.is_empty(list) && queues.length(list) == 0);
        found
    }

    #[test]
    fn nodes_leave_from_every_place() {
        for leaving in 0..3 {
            let (mut queues, list) = queues(3);
            (0..3).for_each(|node| queues.push_back(list, node));
            queues.remove(leaving);
            assert_eq!(queues.list_of(leaving), None);
            queues.remove(leaving);
            let left: Vec<usize> = (0..3).filter(|node| *node != leaving).collect();
            assert_eq!(drain(&mut queues, list), left);
        }
    }

    #[test]
    fn list_by_key_is_sorted_and_equals_stand_in_order_of_arrival() {
        let (mut queues, list) = queues(5);
        for (node, key) in [(0, 10), (1, 30), (2, 10), (3, 30), (4, 20)] {
            queues.push_by_key(list, node, key);
        }
        assert_eq!(drain(&mut queues, list), [1, 3, 4, 0, 2]);
    }

    #[test]
    fn front_comes_before_the_first() {
        let (mut queues, list) = queues(2);
        queues.push_back(list, 0);
        queues.push_front(list, 1);
        assert_eq!(drain(&mut queues, list), [1, 0]);
    }
}
