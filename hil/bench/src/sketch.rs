//! Schedule files that the figures generate.

use std::fmt::Write;

/// One partition of a generated module.
#[derive(Debug, Clone, Default)]
pub(super) struct Sketched {
    /// Its name.
    pub(super) name: String,
    /// Its program; empty: the bench's own.
    pub(super) program: String,
    /// Attributes as TOML, such as `does = "fill"`.
    pub(super) attributes: String,
    /// Threads that it declares; 0: one.
    pub(super) threads: u32,
    /// Further keys as TOML lines.
    pub(super) more: String,
    /// Windows in each minor frame: offset and length, us.
    pub(super) windows: Vec<(u64, u64)>,
}

impl Sketched {
    pub(super) fn new(name: impl Into<String>, does: &str, windows: &[(u64, u64)]) -> Self {
        let attributes = format!("does = \"{does}\"");
        Self { name: name.into(), attributes, windows: windows.to_vec(), ..Self::default() }
    }
}

/// A channel of a generated module: its source's partition, its destination's.
#[derive(Debug, Clone, Copy)]
pub(super) struct Link {
    pub(super) from: usize,
    pub(super) to: usize,
}

/// The schedule file of one module on `core` with a frame of `frame_us`.
pub(super) fn schedule(core: u32, frame_us: u64, partitions: &[Sketched], links: &[Link]) -> String {
    let mut text = format!(
        "[module.bench]\ncores = [{core}]\n\n[health]\nsilence_windows = 1000000\n\n[health.partition]\nwindow_overrun = \"ignore\"\n"
    );
    for (place, partition) in partitions.iter().enumerate() {
        add_partition(&mut text, place, partition, links);
    }
    for (number, link) in links.iter().enumerate() {
        let (from, to) = (&partitions[link.from].name, &partitions[link.to].name);
        // Writing to a text does not fail.
        let _ = writeln!(
            text,
            "\n[[channel]]\nsource = \"{from}.out{number}\"\ndestinations = [\"{to}.in{number}\"]"
        );
    }
    let _ = write!(
        text,
        "\n[schedule.bench]\nmajor_frame = \"{frame_us}us\"\nminor_frame = \"{frame_us}us\"\nwindow = [\n"
    );
    for partition in partitions {
        for (offset, length) in &partition.windows {
            let name = &partition.name;
            let _ = writeln!(
                text,
                "  {{ partition = \"{name}\", offset = \"{offset}us\", duration = \"{length}us\" }},"
            );
        }
    }
    text + "]\n"
}

fn add_partition(text: &mut String, place: usize, partition: &Sketched, links: &[Link]) {
    let Sketched { name, program, attributes, threads, more, .. } = partition;
    let program = if program.is_empty() { "bateleur_bench_partition" } else { program };
    let threads = (*threads).max(1);
    let _ = writeln!(
        text,
        "\n[partition.{name}]\nprogram = \"{program}\"\nmodule = \"bench\"\nmemory = \"64MiB\"\n\
         threads = {threads}\nattributes = {{ {attributes} }}\n{more}"
    );
    let _ = writeln!(text, "[partition.{name}.port]");
    for (number, link) in links.iter().enumerate() {
        if link.from == place {
            let _ = writeln!(
                text,
                "out{number} = {{ direction = \"source\", kind = \"sampling\", message = \"Rates\" }}"
            );
        }
        if link.to == place {
            let _ = writeln!(
                text,
                "in{number} = {{ direction = \"destination\", kind = \"sampling\", message = \"Rates\", refresh = \"1s\" }}"
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::schema_check::fault_in;
    use bateleur_executive_cli::plan_file;

    #[test]
    fn a_generated_schedule_breaks_no_rule_and_meets_the_schema() {
        let mut ring: Vec<Sketched> = (0..3)
            .map(|number| Sketched::new(format!("p{number}"), "fill", &[(number * 300, 300)]))
            .collect();
        ring[0].more = "standby = \"hot\"".into();
        let links: Vec<Link> = (0..3).map(|number| Link { from: number, to: (number + 1) % 3 }).collect();
        let text = schedule(1, 1000, &ring, &links);
        let plan = plan_file::read_text("generated", &text);
        let plan = plan.map_err(|report| report.render(false)).unwrap();
        assert_eq!((plan.partitions.len(), plan.channels.len()), (3, 3));
        assert_eq!(fault_in(&bateleur_checker::schema(), &text), None, "{text}");
    }
}
