//! The terminal while `top` has it: the other page of it, without a cursor, keys one by one; given back as it was, however `top` ends.

use std::io::{self, Write};

use crossterm::style::{Attribute, Print, SetAttribute};
use crossterm::terminal::{self, Clear, ClearType, EnterAlternateScreen, LeaveAlternateScreen};
use crossterm::{cursor, execute, queue};

use crate::printed::Printed;

/// How a line is shown.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) enum Style {
    #[default]
    Plain,
    Bold,
    Dim,
    /// Dark on light, as what is chosen.
    Reverse,
}

/// A line of the screen.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Line {
    pub style: Style,
    pub text: String,
}

impl Line {
    pub(super) fn new(style: Style, text: impl Into<String>) -> Self {
        Self { style, text: text.into() }
    }
}

/// See the module's head.
#[derive(Debug)]
pub(super) struct Screen {
    /// What is shown: only lines that differ are written.
    shown: Vec<Line>,
    size: (usize, usize),
}

impl Screen {
    pub(super) fn open() -> io::Result<Self> {
        terminal::enable_raw_mode()?;
        let screen = Self { shown: Vec::new(), size: (0, 0) }; // gives it back if the next one fails
        execute!(Printed, EnterAlternateScreen, cursor::Hide)?;
        Ok(screen)
    }

    /// Shows lines that are made for the terminal's width and height.
    pub(super) fn show(&mut self, lines: impl FnOnce((usize, usize)) -> Vec<Line>) -> io::Result<()> {
        let (width, height) = terminal::size()?;
        let size = (usize::from(width), usize::from(height));
        let mut lines = lines(size);
        lines.resize(size.1, Line::default());
        let mut output = Printed;
        if self.size != size {
            (self.size, self.shown) = (size, Vec::new());
            queue!(output, Clear(ClearType::All))?;
        }
        for (row, line) in lines.iter().enumerate().filter(|(row, line)| self.shown.get(*row) != Some(line)) {
            let text: String = line.text.chars().take(size.0).collect();
            let attribute = match line.style {
                Style::Plain => Attribute::Reset,
                Style::Bold => Attribute::Bold,
                Style::Dim => Attribute::Dim,
                Style::Reverse => Attribute::Reverse,
            };
            let row = u16::try_from(row).unwrap_or(u16::MAX);
            queue!(
                output,
                cursor::MoveTo(0, row),
                SetAttribute(Attribute::Reset),
                Clear(ClearType::CurrentLine)
            )?;
            queue!(output, SetAttribute(attribute), Print(text), SetAttribute(Attribute::Reset))?;
        }
        self.shown = lines;
        output.flush()
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        let _ = execute!(Printed, cursor::Show, LeaveAlternateScreen); // it is gone
        let _ = terminal::disable_raw_mode(); // as above
    }
}
