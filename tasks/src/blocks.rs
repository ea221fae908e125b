//! The console blocks of the project's pages: which commands they show, and what they say comes of them.
//!
//! A block is fenced as `console`. A line that begins with `$ ` is a command, the lines after it are its output, in which `…`
//! stands for anything within a line, and alone on a line for any lines. What is special about it stands behind `console`, which
//! no reader of the book sees, and what has to be done first in comments directly above: see [`Block::direct`].

/// What stands before a command that has to be run first.
const MARK: &str = "<!-- before: ";
/// What a block's fence begins with.
const FENCE: &str = "console";

/// One block of a page.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Block {
    /// Line of the page on which it begins.
    pub(crate) line: usize,
    pub(crate) commands: Vec<Shown>,
    /// Why it is not run here.
    pub(crate) not_run: Option<String>,
    /// What has to be done first, unseen.
    pub(crate) before: Vec<String>,
    /// Exit code of every command.
    pub(crate) exit: i32,
    /// Lines of the output are left out without a mark.
    pub(crate) shortened: bool,
    /// One number is as good as another.
    pub(crate) numbers_vary: bool,
    /// Directives that nobody knows.
    pub(crate) unknown: Vec<String>,
}

/// A command and the output that the page shows; none shown, none compared.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Shown {
    pub(crate) command: String,
    pub(crate) output: Vec<String>,
}

/// The blocks of a page.
pub(crate) fn blocks(text: &str) -> Vec<Block> {
    let mut found = Vec::new();
    let mut next = Block::default();
    let mut lines = text.lines().enumerate();
    while let Some((number, line)) = lines.next() {
        if let Some(directive) = line.trim().strip_prefix(MARK).and_then(|rest| rest.strip_suffix("-->")) {
            next.before.push(directive.trim().to_owned());
        } else if let Some(fence) = line.trim().strip_prefix("```") {
            let inside: Vec<&str> =
                lines.by_ref().map(|(_, line)| line).take_while(|line| line.trim() != "```").collect();
            if let Some(special) = fence.strip_prefix(FENCE) {
                let special = special.split("; ").map(str::trim).filter(|directive| !directive.is_empty());
                special.for_each(|directive| next.direct(directive));
                found.push(Block {
                    line: number + 1,
                    commands: commands(&inside),
                    ..std::mem::take(&mut next)
                });
            }
            next = Block::default();
        } else if !line.trim().is_empty() {
            next = Block::default(); // what stood above belongs to no block
        }
    }
    found
}

fn commands(lines: &[&str]) -> Vec<Shown> {
    let mut found: Vec<Shown> = Vec::new();
    for line in lines {
        match (line.strip_prefix("$ "), found.last_mut()) {
            (Some(command), _) => found.push(Shown { command: command.to_owned(), output: Vec::new() }),
            (None, Some(shown)) => shown.output.push((*line).to_owned()),
            (None, None) => {}
        }
    }
    found
}

impl Block {
    fn direct(&mut self, directive: &str) {
        let (word, rest) = directive.split_once([' ', ',']).unwrap_or((directive, ""));
        match (word, rest.trim()) {
            ("shortened", "") => self.shortened = true,
            ("numbers", "vary") => self.numbers_vary = true,
            ("exit", code) if code.parse::<i32>().is_ok() => self.exit = code.parse().unwrap_or(0),
            ("not", rest) if rest.strip_prefix("run, ").is_some_and(|reason| !reason.is_empty()) => {
                self.not_run = rest.strip_prefix("run, ").map(str::to_owned);
            }
            _ => self.unknown.push(directive.to_owned()),
        }
    }

    /// Whether `said` is what the page shows; else the first line of the page that is not there.
    pub(crate) fn compare(&self, shown: &[String], said: &str) -> Result<(), String> {
        let plain = |line: &str| {
            if self.numbers_vary { without_numbers(line.trim_end()) } else { line.trim_end().into() }
        };
        let said: Vec<String> = said.lines().map(plain).collect();
        let (mut place, mut gap) = (0, self.shortened);
        for line in shown {
            let wanted = plain(line);
            if wanted.trim() == "…" {
                gap = true;
                continue;
            }
            let rest = said.get(place..).unwrap_or_default();
            let found = rest.iter().position(|line| matches(&wanted, line)).filter(|at| gap || *at == 0);
            place += found.ok_or_else(|| line.clone())? + 1;
            gap = self.shortened;
        }
        match said.get(place) {
            Some(more) if !gap && !shown.is_empty() => Err(format!("nothing, where it says: {more}")),
            _ => Ok(()),
        }
    }
}

/// Whether a line is as a page has it, with `…` for any text.
fn matches(pattern: &str, line: &str) -> bool {
    let mut parts = pattern.split('…');
    let Some(mut rest) = line.strip_prefix(parts.next().unwrap_or_default()) else { return false };
    let mut parts: Vec<&str> = parts.collect();
    let Some(last) = parts.pop() else { return rest.is_empty() };
    for part in parts {
        let Some(at) = rest.find(part) else { return false };
        rest = &rest[at + part.len()..];
    }
    rest.ends_with(last)
}

/// A line with `#` for each number, and one blank for several: columns move with their numbers.
fn without_numbers(line: &str) -> String {
    let mut plain = String::new();
    for letter in line.chars() {
        let letter = if letter.is_ascii_digit() { '#' } else { letter };
        let again = (letter == '#' || letter == ' ') && plain.ends_with(letter);
        if !again {
            plain.push(letter);
        }
    }
    plain.replace("#.#", "#")
}

#[cfg(test)]
mod tests {
    use super::*;

    const PAGE: &str = "Text.\n\n\n<!-- before: sed -i 's/a/b/' c -->\n```console exit 1\n$ check # why\nerror\n…\n$ other\n```\n\
                        \n```console not run, needs a terminal; numbers vary\n$ top\n```\n```toml\n$ no = 1\n```\n<!-- before: other -->\n\
                        Prose between.\n```console\n$ last\n```\n\n```console shortend\n```\n";

    #[test]
    fn blocks_are_found_with_their_directives() {
        let found = blocks(PAGE);
        assert_eq!(found.len(), 4);
        assert_eq!((found[0].line, found[0].exit, found[0].before.len()), (5, 1, 1));
        assert_eq!(
            found[0].commands[0],
            Shown { command: "check # why".into(), output: vec!["error".into(), "…".into()] }
        );
        assert_eq!(found[0].commands[1].command, "other");
        assert_eq!(found[1].not_run.as_deref(), Some("needs a terminal"));
        assert!(found[1].numbers_vary && found[1].before.is_empty());
        assert_eq!((found[2].before.len(), found[2].line), (0, 20), "prose takes a directive's force");
        assert_eq!(found[3].unknown, ["shortend"]);
    }

    fn compare(block: &Block, shown: &str, said: &str) -> Result<(), String> {
        block.compare(&shown.lines().map(str::to_owned).collect::<Vec<_>>(), said)
    }

    #[test]
    fn output_must_be_the_shown_one_but_for_what_is_left_out() {
        let exact = Block::default();
        assert_eq!(compare(&exact, "one\ntwo", "one\ntwo\n"), Ok(()));
        assert_eq!(compare(&exact, "", "anything"), Ok(()), "nothing shown, nothing compared");
        assert_eq!(compare(&exact, "one\n…\nfour", "one\ntwo\nthree\nfour"), Ok(()));
        assert_eq!(compare(&exact, "one\n…", "one\ntwo"), Ok(()));
        assert_eq!(compare(&exact, "in … s: …", "in 5 s: fine"), Ok(()));
        assert_eq!(compare(&exact, "one\nthree", "one\ntwo\nthree"), Err("three".into()));
        assert_eq!(compare(&exact, "one", "one\ntwo"), Err("nothing, where it says: two".into()));
        assert_eq!(compare(&exact, "one…two", "one"), Err("one…two".into()));
    }

    #[test]
    fn shortened_output_keeps_its_order_and_numbers_may_vary() {
        let block = Block { shortened: true, numbers_vary: true, ..Block::default() };
        let said = "not guaranteed here: x\n   19.100 s  engaging\n  26.1 s  1 of 9 reached at 191.2 m\nend";
        assert_eq!(
            compare(&block, "    9.600 s  engaging\n   36.100 s  1 of 9 reached at 91.2 m", said),
            Ok(())
        );
        assert!(compare(&block, "end\n   19.100 s  engaging", said).is_err());
        assert!(compare(&block, "   19.100 s  landing", said).is_err());
    }
}
