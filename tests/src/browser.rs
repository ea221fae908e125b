//! A real browser without a screen: Chromium, which `tests/browser/prepare` installs.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use serde_json::Value;

use crate::await_some;

/// A browser starts in a second or two; a busy machine takes longer.
const PATIENCE: Duration = Duration::from_secs(90);
/// Measures every figure once the page is laid out, and leaves the result in the page.
const MEASURE: &str = r#"<script>
addEventListener("load", () => {
  const figures = [...document.querySelectorAll("figure svg")].map(svg => {
    const box = svg.getBoundingClientRect();
    const drawn = [...svg.querySelectorAll("path.line, path.dots, rect.used, rect.there, rect.planned")];
    const strokes = drawn.map(each => ({ box: each.getBoundingClientRect(), style: getComputedStyle(each) }));
    return {
      title: svg.getAttribute("aria-label"),
      width: box.width,
      height: box.height,
      left: box.left,
      right: box.right,
      drawn: strokes.filter(each => each.box.width + each.box.height > 1).length,
      coloured: strokes.filter(each => /rgb\((?!0, 0, 0)/.test(each.style.stroke + each.style.fill)).length,
      outside: strokes.filter(each => each.box.left < box.left - 2 || each.box.right > box.right + 2
        || each.box.top < box.top - 2 || each.box.bottom > box.bottom + 2).length,
    };
  });
  const result = document.createElement("pre");
  result.id = "measured";
  result.textContent = JSON.stringify({ figures, width: document.documentElement.scrollWidth, shown: innerWidth });
  document.body.append(result);
});
</script>"#;

/// A browser.
#[derive(Debug)]
pub struct Browser(PathBuf);

/// What a browser made of a page.
#[derive(Debug)]
pub struct Seen {
    /// Every line that the page, or the browser about it, wrote to the console.
    pub console: Vec<String>,
    /// Figures with their places and what is drawn in them; the widths of the page and of the screen.
    pub measured: Value,
}

impl Browser {
    /// The browser of this machine. `None` if there is none, and that has been said; the test is to be left out. In CI that is
    /// a failure.
    pub fn find() -> Option<Self> {
        let folders = std::env::var_os("PATH").unwrap_or_default();
        let found =
            std::env::split_paths(&folders).map(|folder| folder.join("chromium")).find(|path| path.is_file());
        if found.is_none() {
            let needed = std::env::var_os("CI").is_some_and(|value| value == "true");
            assert!(!needed, "a browser is needed in CI: tests/browser/prepare installs it");
            eprintln!("NOT TESTED in a browser: there is no chromium (on Debian: tests/browser/prepare)");
        }
        found.map(Self)
    }

    /// Its program.
    pub(crate) fn path(&self) -> &Path {
        &self.0
    }

    /// Opens a copy of a page on a screen of that width, px, measures its figures and listens to its console.
    pub fn open(&self, page: &Path, width: u32) -> Seen {
        let folder = tempfile::Builder::new().prefix("bateleur-browser-").tempdir().unwrap();
        let text = fs::read_to_string(page).unwrap();
        let (head, foot) = text.rsplit_once("</body>").expect("the page has an end");
        let copy = folder.path().join("page.html");
        fs::write(&copy, format!("{head}{MEASURE}</body>{foot}")).unwrap();
        let (out, said) = (folder.path().join("out"), folder.path().join("said"));
        let mut browser = Command::new(&self.0)
            .args([
                "--headless",
                "--no-sandbox",
                "--disable-gpu",
                "--disable-dev-shm-usage",
                "--enable-logging=stderr",
            ])
            .arg(format!("--user-data-dir={}", folder.path().join("profile").display()))
            .arg(format!("--window-size={width},1200"))
            .arg("--dump-dom")
            .arg(format!("file://{}", copy.display()))
            .stdin(Stdio::null())
            .stdout(fs::File::create(&out).unwrap())
            .stderr(fs::File::create(&said).unwrap())
            .spawn()
            .unwrap();
        let ended = await_some(PATIENCE, || browser.try_wait().unwrap());
        if ended.is_none() {
            browser.kill().unwrap();
            browser.wait().unwrap();
        }
        let said = String::from_utf8_lossy(&fs::read(&said).unwrap()).into_owned();
        assert!(ended.is_some_and(|status| status.success()), "the browser did not come to its end:\n{said}");
        let shown = fs::read_to_string(&out).unwrap();
        let measured =
            shown.split_once(r#"<pre id="measured">"#).and_then(|(_, rest)| rest.split_once("</pre>"));
        let (measured, _) = measured.unwrap_or_else(|| panic!("the page's own script did not run:\n{said}"));
        let measured = measured.replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&");
        Seen {
            console: said.lines().filter(|line| line.contains("CONSOLE")).map(str::to_owned).collect(),
            measured: serde_json::from_str(&measured).unwrap(),
        }
    }
}

impl Seen {
    /// The figures.
    pub fn figures(&self) -> &[Value] {
        self.measured["figures"].as_array().unwrap()
    }

    /// The figure of that title.
    pub fn figure(&self, title: &str) -> &Value {
        let found = self.figures().iter().find(|figure| figure["title"] == title);
        found.unwrap_or_else(|| panic!("no figure \"{title}\""))
    }
}
