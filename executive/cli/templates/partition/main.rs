//! The partition `{{ partition }}`: say here in a sentence what it is for, and what it must never do.
//!
//! `bateleur new` made it from the schedule file. It runs as it is, and what it sends are zeros. Once `window` has
//! more than a few lines, put what it computes into `src/lib.rs`, which knows no ports and no clock.
{% for grant in grants %}
//!
//! {{ grant }}
{% endfor %}

use std::process::ExitCode;

{{ imports }}
{% if messages %}

mod types {
    bateleur_apex::messages!({{ messages }});
}
{% endif %}
{% for port in ports if port.kind == "QueuingDestination" %}

/// Messages of `{{ port.name }}` that one window takes at most: as many as may wait there.
const {{ port.depth_name }}: u32 = {{ port.depth }};
{% endfor %}
{% if sends %}

/// In one of so many windows a message goes into each queue: a full one helps nobody.
const SEND_EVERY: u64 = 50;
{% endif %}
{% for size in byte_sizes %}

/// Plain bytes: give them a meaning, or a message type of their own.
#[derive(Debug, Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
struct Bytes{{ size }}([u8; {{ size }}]);

impl Message for Bytes{{ size }} {
    const NAME: &'static str = "bytes";
    const FIELDS: &'static [Field] =
        &[Field { name: "bytes", unit: "", kind: FieldKind::U8, count: {{ size }}, offset: 0 }];
}
{% endfor %}
{% if kept %}

/// What the next incarnation finds after a warm restart: plain data, with padding written out as fields.
#[derive(Debug, Clone, Copy, Default, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
struct Kept {
    /// Windows so far, of all incarnations.
    windows: u64,
}
{% endif %}

struct {{ type_name }} {
{% for port in ports %}
    {{ port.field }}: {{ port.kind }}<{{ port.type }}>,
{% endfor %}
{% for attribute in attributes %}
    /// Attribute `{{ attribute.shown }}`{{ attribute.unit }}.
    {{ attribute.field }}: {{ attribute.type }},
{% endfor %}
{% if kept %}
    retained: Retained<Kept>,
    kept: Kept,
{% endif %}
    /// Windows of this incarnation.
    windows: u64,
}

impl Partition for {{ type_name }} {
{% if error_handler %}
    const ERROR_HANDLER: bool = true;

{% endif %}
{% if like_a_constant %}
    #[allow(clippy::approx_constant)] // a value of the schedule file, not of mathematics
{% endif %}
    fn start({{ "" if ports or attributes or kept else "_" }}context: &mut Context) -> Result<Self, StartError> {
        // Before the first window, with all the time of `startup_timeout`: here it may allocate, read files and fail. The
        // text of an error is what the operator reads.
{% if kept %}
        let mut retained = context.retained::<Kept>()?;
        // Nothing after a cold start. It comes from an incarnation that failed: believe only what makes sense.
        let kept = retained.load().unwrap_or_default();
{% endif %}
{% if attributes %}
        // What stands beside the name of an attribute holds where the schedule file says nothing.
{% endif %}
{{ started }}
    }

{% if standby %}
    fn take_over(&mut self, _takeover: &Takeover) {
        // It stood by until now: what `start` loaded is long out of date.
{% if kept %}
        self.kept = self.retained.load().unwrap_or_default();
{% else %}
        // Nothing is kept: with `retained` in the schedule file there would be something to load here.
{% endif %}
    }

{% endif %}
{% if error_handler %}
    fn error_handler(&mut self, error: &HealthError, window: &Window) -> Response {
        // An error that the plan leaves to this partition. Another answer ends it: see `Response`.
        window.report(&format!("{:?}: {}", error.code, error.message));
        Response::GoOn
    }

{% endif %}
    fn window(&mut self, window: &Window) {
        if self.windows == 0 {
{% for told in told_alone %}
            window.report({{ told }});
{% endfor %}
{% if told_together %}
            let told = [
{% for told in told_together %}
                {{ told }},
{% endfor %}
            ];
            window.report(&told.join(", ")); // its first 128 bytes
{% endif %}
        }
{% if samples %}
        // None before the first message, and none once the last is older than the port's `refresh`.
{% endif %}
{% for port in ports if port.kind == "SamplingDestination" %}
        let _{{ port.field }} = self.{{ port.field }}.read_valid();
{% endfor %}
{% for port in ports if port.kind == "QueuingDestination" %}
        for _ in 0..{{ port.depth_name }} {
            let Some(_message) = self.{{ port.field }}.receive() else { break };
        }
{% endfor %}
        // Compute here. Nothing may block, and every loop needs a bound; the time is `window.start_ns()` or
        // `window.now_ns()`, never the system's. `window.report` tells the operator, `window.raise` is a health error.
        self.windows += 1;
{% if kept %}
        self.kept.windows += 1;
{% endif %}
{% for port in ports if port.kind == "SamplingSource" %}
{{ port.put }}
{% endfor %}
{% if sends %}
        if self.windows.is_multiple_of(SEND_EVERY) {
            // Anything but `Sent::Queued` means that it was not taken: try again, or let it go. Never wait.
{% for port in ports if port.kind == "QueuingSource" %}
{{ port.put }}
{% endfor %}
        }
{% endif %}
{% if kept %}
        self.retained.store(&self.kept);
{% endif %}
    }
}

fn main() -> ExitCode {
    bateleur_apex::run::<{{ type_name }}>()
}

#[cfg(test)]
mod tests {
    use bateleur_apex::Harness;

    use super::*;

    #[test]
    fn windows_read_every_destination_and_write_every_source() -> Result<(), StartError> {
        let mut harness = Harness::new("{{ partition }}")?;
{% if kept %}
        harness.retained({{ kept }})?;
{% endif %}
{% for port in ports %}
{{ port.far_end }}
{% endfor %}
        let mut partition = harness.start::<{{ type_name }}>()?;
{% for port in ports if port.sent %}
        {{ port.field }}.{{ port.sent }}(&{{ port.value }});
{% endfor %}
{% if sends %}
        (0..SEND_EVERY).for_each(|_| partition.window());
{% else %}
        partition.window();
{% endif %}
{% for port in ports if port.taken %}
        assert!({{ port.field }}.{{ port.taken }}().is_some());
{% endfor %}
        Ok(())
    }
{% if kept %}

    #[test]
    fn what_is_kept_outlives_a_warm_restart() -> Result<(), StartError> {
        let mut harness = Harness::new("{{ partition }}")?;
        harness.retained({{ kept }})?;
{% for port in ports %}
{{ port.far_end_held }}
{% endfor %}
        let mut first = harness.start::<{{ type_name }}>()?;
        first.window();
        first.window();
        drop(first);
{% if standby %}
        let mut second = harness.start::<{{ type_name }}>()?;
        assert_eq!(second.partition.kept.windows, 2);
        // One that stood by has to look again.
        second.partition.kept = Kept::default();
        second.take_over();
{% else %}
        let second = harness.start::<{{ type_name }}>()?;
{% endif %}
        assert_eq!(second.partition.kept.windows, 2);
        Ok(())
    }
{% endif %}
}
