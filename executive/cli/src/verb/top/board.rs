//! What `top` shows and what its keys do, without a terminal.

use std::cmp::Ordering;

use bateleur_control::{PartitionStatus, Request, Status};
use bateleur_monitor::inject::Fault;
use crossterm::event::{KeyCode, KeyEvent, KeyModifiers};

/// Faults of a partition that need no value.
fn faults() -> impl Iterator<Item = &'static str> {
    Fault::names().filter(|name| name.parse::<Fault>().is_ok())
}

/// By what the partitions are sorted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Column {
    /// As in the plan.
    Plan,
    Name,
    Mode,
    Restarts,
    Missed,
    Overruns,
    /// Mean use, as a part of the window.
    Use,
    /// The greatest lateness.
    Late,
    Memory,
    LastFault,
}

impl Column {
    pub(super) const ALL: [Self; 10] = [
        Self::Plan,
        Self::Name,
        Self::Mode,
        Self::Restarts,
        Self::Missed,
        Self::Overruns,
        Self::Use,
        Self::Late,
        Self::Memory,
        Self::LastFault,
    ];

    pub(super) fn word(self) -> &'static str {
        match self {
            Self::Plan => "plan",
            Self::Name => "name",
            Self::Mode => "mode",
            Self::Restarts => "restarts",
            Self::Missed => "missed",
            Self::Overruns => "overruns",
            Self::Use => "use",
            Self::Late => "lateness",
            Self::Memory => "memory",
            Self::LastFault => "last fault",
        }
    }

    /// What is worst, or first in the alphabet, comes first.
    fn compare(self, one: &Row, other: &Row) -> Ordering {
        let (a, b) = (&one.partition, &other.partition);
        match self {
            Self::Plan => Ordering::Equal,
            Self::Name => a.name.cmp(&b.name),
            Self::Mode => a.mode.cmp(&b.mode),
            Self::Restarts => b.restarts.cmp(&a.restarts),
            Self::Missed => b.windows_missed.cmp(&a.windows_missed),
            Self::Overruns => b.overruns.cmp(&a.overruns),
            Self::Use => other.share().total_cmp(&one.share()),
            Self::Late => latest(b).cmp(&latest(a)),
            Self::Memory => other.memory.cmp(&one.memory),
            Self::LastFault => last_fault_ns(b).cmp(&last_fault_ns(a)),
        }
    }
}

fn latest(partition: &PartitionStatus) -> u64 {
    partition.lateness_ns.map_or(0, |late| late.max)
}

fn last_fault_ns(partition: &PartitionStatus) -> Option<u64> {
    partition.last_fault.as_ref().map(|fault| fault.time_ns)
}

/// A partition, and what this program finds out of it by itself.
#[derive(Debug, Clone)]
pub(super) struct Row {
    pub partition: PartitionStatus,
    /// Resident memory, bytes.
    pub memory: Option<u64>,
}

impl Row {
    /// Mean use, as a part of its window.
    pub(super) fn share(&self) -> f64 {
        let mean = self.partition.use_ns.map_or(0, |used| used.mean);
        mean as f64 / self.partition.window_ns.max(1) as f64
    }
}

/// What a key leads to outside of the board.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Act {
    Leave,
    Order(Request),
}

/// What lies over the table.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Over {
    Help,
    /// An order that ends or disturbs something waits for a yes.
    Confirm {
        question: String,
        request: Request,
    },
    /// One of several.
    Choose {
        title: String,
        of: Vec<String>,
        chosen: usize,
        kind: Kind,
    },
}

/// What is chosen.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Kind {
    Schedule,
    /// For that partition.
    Fault(String),
}

/// See the module's head.
#[derive(Debug)]
pub(super) struct Board {
    pub status: Status,
    /// In the order in which they are shown.
    pub rows: Vec<Row>,
    pub sorted_by: Column,
    pub reversed: bool,
    /// The name of the partition that is chosen: it stays so, wherever it is sorted to.
    pub chosen: String,
    /// Whether its details are shown.
    pub details: bool,
    pub over: Option<Over>,
    /// What the last order led to.
    pub said: Option<Result<String, String>>,
}

impl Board {
    pub(super) fn of(status: Status) -> Self {
        let chosen = status.partitions.first().map(|one| one.name.clone()).unwrap_or_default();
        let mut board = Self {
            status: Status::default(),
            rows: Vec::new(),
            sorted_by: Column::Plan,
            reversed: false,
            chosen,
            details: false,
            over: None,
            said: None,
        };
        board.take(status);
        board
    }

    /// New figures.
    pub(super) fn take(&mut self, status: Status) {
        self.status = status;
        self.sort();
    }

    pub(super) fn answered(&mut self, said: Result<String, String>) {
        self.said = Some(said);
    }

    fn sort(&mut self) {
        let row = |partition: &PartitionStatus| Row {
            partition: partition.clone(),
            memory: partition.pid.and_then(super::super::metrics::resident),
        };
        self.rows = self.status.partitions.iter().map(row).collect();
        let by = self.sorted_by;
        self.rows.sort_by(|one, other| by.compare(one, other)); // equal ones stay as in the plan
        if self.reversed {
            self.rows.reverse();
        }
    }

    /// Where the chosen one is shown.
    pub(super) fn at(&self) -> usize {
        self.rows.iter().position(|row| row.partition.name == self.chosen).unwrap_or(0)
    }

    fn step(&mut self, by: isize) {
        let last = self.rows.len().saturating_sub(1);
        let at = self.at().saturating_add_signed(by).min(last);
        self.chosen = self.rows.get(at).map(|row| row.partition.name.clone()).unwrap_or_default();
    }

    /// A key was pressed.
    pub(super) fn press(&mut self, key: KeyEvent) -> Option<Act> {
        if key.modifiers.contains(KeyModifiers::CONTROL) {
            return matches!(key.code, KeyCode::Char('c' | 'd')).then_some(Act::Leave);
        }
        match self.over.take() {
            None => self.press_on_table(key.code),
            Some(Over::Help) => None,
            Some(Over::Confirm { question, request }) => match key.code {
                KeyCode::Char('y' | 'Y') => Some(Act::Order(request)),
                KeyCode::Char('n' | 'N' | 'q') | KeyCode::Esc => None,
                _ => {
                    self.over = Some(Over::Confirm { question, request });
                    None
                }
            },
            Some(Over::Choose { title, of, chosen, kind }) => {
                self.press_on_list(key.code, title, of, chosen, kind)
            }
        }
    }

    fn press_on_list(
        &mut self,
        code: KeyCode,
        title: String,
        of: Vec<String>,
        mut chosen: usize,
        kind: Kind,
    ) -> Option<Act> {
        match code {
            KeyCode::Esc | KeyCode::Char('q') => return None,
            KeyCode::Enter => {
                let word = of.get(chosen)?.clone();
                return Some(Act::Order(match kind {
                    Kind::Schedule => Request::Schedule { name: word },
                    Kind::Fault(target) => Request::Inject { target, fault: word },
                }));
            }
            KeyCode::Up | KeyCode::Char('k') => chosen = chosen.saturating_sub(1),
            KeyCode::Down | KeyCode::Char('j') => chosen = (chosen + 1).min(of.len().saturating_sub(1)),
            KeyCode::Char(letter) => {
                // The next one that begins so.
                let next = of.iter().enumerate().cycle().skip(chosen + 1).take(of.len());
                chosen = next.clone().find(|(_, word)| word.starts_with(letter)).map_or(chosen, |(at, _)| at);
            }
            _ => {}
        }
        self.over = Some(Over::Choose { title, of, chosen, kind });
        None
    }

    fn press_on_table(&mut self, code: KeyCode) -> Option<Act> {
        let partition = self.chosen.clone();
        match code {
            KeyCode::Char('q') => return Some(Act::Leave),
            KeyCode::Esc if self.details => self.details = false,
            KeyCode::Esc => return Some(Act::Leave),
            KeyCode::Up | KeyCode::Char('k') => self.step(-1),
            KeyCode::Down | KeyCode::Char('j') => self.step(1),
            KeyCode::PageUp => self.step(-10),
            KeyCode::PageDown => self.step(10),
            KeyCode::Home => self.step(-isize::MAX),
            KeyCode::End => self.step(isize::MAX),
            KeyCode::Enter => self.details = !self.details,
            KeyCode::Char('?' | 'h') => self.over = Some(Over::Help),
            KeyCode::Char('s' | '>') => self.sort_by_next(1),
            KeyCode::Char('<') => self.sort_by_next(Column::ALL.len() - 1),
            KeyCode::Char('r') => {
                self.reversed = !self.reversed;
                self.sort();
            }
            KeyCode::Char('K') => self.confirm("kill", Request::Kill { partition }),
            KeyCode::Char('S') => self.confirm("stop", Request::Stop { partition }),
            KeyCode::Char('A') => return Some(Act::Order(Request::Start { partition })),
            KeyCode::Char('F') => self.confirm("freeze", Request::Freeze { partition }),
            KeyCode::Char('T') => return Some(Act::Order(Request::Thaw { partition })),
            KeyCode::Char('I') => {
                let of = faults().map(str::to_owned).collect();
                let title = format!("provoke a fault in {partition}");
                self.over = Some(Over::Choose { title, of, chosen: 0, kind: Kind::Fault(partition) });
            }
            KeyCode::Char('C') => {
                let (of, title) = (self.status.schedules.clone(), "change to schedule".to_owned());
                let chosen = of.iter().position(|name| *name == self.status.schedule).unwrap_or(0);
                self.over = Some(Over::Choose { title, of, chosen, kind: Kind::Schedule });
            }
            _ => {}
        }
        None
    }

    fn sort_by_next(&mut self, by: usize) {
        let at = Column::ALL.iter().position(|column| *column == self.sorted_by).unwrap_or(0);
        self.sorted_by = Column::ALL[(at + by) % Column::ALL.len()];
        self.sort();
    }

    fn confirm(&mut self, what: &str, request: Request) {
        let question = format!("{what} {}? (y/n)", self.chosen);
        self.over = Some(Over::Confirm { question, request });
    }
}

#[cfg(test)]
mod tests {
    use bateleur_control::status::{Lateness, Spread};

    use super::*;

    /// Partitions with figures that put them into another order by each column.
    pub(crate) fn status() -> Status {
        let partition = |(name, window_ns, mean, max): (&str, u64, u64, u64)| PartitionStatus {
            name: name.into(),
            mode: "normal".into(),
            window_ns,
            use_ns: Some(Spread { min: 1, mean, max: mean * 2 }),
            lateness_ns: Some(Lateness { max, ..Lateness::default() }),
            ..PartitionStatus::default()
        };
        let partitions = [("imu", 1000, 100, 30), ("gps", 100, 90, 10), ("servo", 1000, 500, 20)];
        Status {
            module: "fcu".into(),
            schedules: vec!["cruise".into(), "glide".into()],
            schedule: "cruise".into(),
            partitions: partitions.map(partition).into(),
            ..Status::default()
        }
    }

    fn press(board: &mut Board, keys: &str) -> Option<Act> {
        let code = |letter| match letter {
            '\n' => KeyCode::Enter,
            '\x1b' => KeyCode::Esc,
            '^' => KeyCode::Up,
            'v' => KeyCode::Down,
            letter => KeyCode::Char(letter),
        };
        keys.chars().map(|letter| board.press(KeyEvent::from(code(letter)))).last().flatten()
    }

    fn names(board: &Board) -> Vec<&str> {
        board.rows.iter().map(|row| row.partition.name.as_str()).collect()
    }

    #[test]
    fn partitions_are_sorted_by_each_column_and_the_chosen_one_stays_chosen() {
        let mut board = Board::of(status());
        press(&mut board, "v");
        assert_eq!((names(&board), board.chosen.as_str()), (vec!["imu", "gps", "servo"], "gps"));
        let mut by = |column| {
            while board.sorted_by != column {
                press(&mut board, "s");
            }
            assert_eq!(board.chosen, "gps");
            names(&board).join(" ")
        };
        assert_eq!(by(Column::Name), "gps imu servo");
        assert_eq!(by(Column::Use), "gps servo imu", "as a part of the window");
        assert_eq!(by(Column::Late), "imu servo gps");
        press(&mut board, "r");
        assert_eq!(names(&board), ["gps", "servo", "imu"]);
        press(&mut board, "v");
        assert_eq!(board.chosen, "servo");
        for _ in Column::ALL {
            press(&mut board, "s<s");
        }
        assert_eq!(board.sorted_by, Column::Late, "all the way round");
        // It has gone: the next key chooses one that is there.
        let mut fewer = status();
        fewer.partitions.truncate(2);
        board.take(fewer);
        press(&mut board, "^");
        assert!(names(&board).contains(&board.chosen.as_str()));
    }

    #[test]
    fn what_disturbs_a_partition_is_asked_twice_and_nothing_else_is_a_yes() {
        let mut board = Board::of(status());
        let imu = || "imu".to_owned();
        for (key, request) in [
            ("K", Request::Kill { partition: imu() }),
            ("S", Request::Stop { partition: imu() }),
            ("F", Request::Freeze { partition: imu() }),
        ] {
            assert_eq!(press(&mut board, key), None);
            for no in ["n", "\x1b", "q"] {
                assert_eq!(press(&mut board, no), None);
                assert_eq!(board.over, None);
                press(&mut board, key);
            }
            assert_eq!(press(&mut board, "\nvxK"), None, "still asked");
            assert_eq!(press(&mut board, "y"), Some(Act::Order(request)));
        }
        assert_eq!(press(&mut board, "A"), Some(Act::Order(Request::Start { partition: imu() })));
        assert_eq!(press(&mut board, "T"), Some(Act::Order(Request::Thaw { partition: imu() })));
        assert_eq!(press(&mut board, "y"), None);
        assert_eq!(press(&mut board, "q"), Some(Act::Leave));
    }

    #[test]
    fn faults_and_schedules_are_chosen_from_lists() {
        let mut board = Board::of(status());
        assert_eq!(press(&mut board, "Cv\n"), Some(Act::Order(Request::Schedule { name: "glide".into() })));
        assert_eq!(press(&mut board, "C\x1b"), None);
        assert_eq!(board.over, None);
        let ordered = press(&mut board, "vIs\n");
        let Some(Act::Order(Request::Inject { target, fault })) = ordered else { panic!("{ordered:?}") };
        assert_eq!(target, "gps");
        assert!(fault.starts_with('s') && fault.parse::<Fault>().is_ok(), "{fault}");
        assert!(faults().count() > 20 && faults().all(|name| name != "stall"));
    }

    #[test]
    fn module_without_partitions_takes_every_key() {
        let mut board = Board::of(Status::default());
        for key in "vv^^srKyI\nC\n?x\n\n<>".chars() {
            press(&mut board, &key.to_string());
        }
        assert_eq!(board.chosen, "");
    }
}
