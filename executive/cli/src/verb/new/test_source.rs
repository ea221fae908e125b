//! The tests of the skeleton: what its author keeps and extends.

use std::fmt::Write;

use bateleur_plan::Role;

use super::skeleton::{Skeleton, SkeletonPort};
use super::source::port_call;
use super::values::grouped;

/// Letters in a line.
const WIDTH: usize = 110;
/// Length of a queue that nobody but the test empties.
const TEST_DEPTH: u32 = 8;

pub(super) fn text(skeleton: &Skeleton) -> String {
    let mut out =
        "\n#[cfg(test)]\nmod tests {\n    use bateleur_apex::Harness;\n\n    use super::*;\n".to_owned();
    out += &ports_test(skeleton);
    if skeleton.retained_bytes.is_some() {
        out += &retained_test(skeleton);
    }
    out + "}\n"
}

fn is_source(port: &&SkeletonPort) -> bool {
    matches!(port.role, Role::SamplingSource | Role::QueuingSource)
}

fn ports_test(skeleton: &Skeleton) -> String {
    let destinations: Vec<&SkeletonPort> = skeleton.ports.iter().filter(|port| !is_source(port)).collect();
    let sources: Vec<&SkeletonPort> = skeleton.ports.iter().filter(is_source).collect();
    let queues = sources.iter().any(|port| port.role == Role::QueuingSource);
    let mut out = "\n    #[test]\n    fn windows_read_every_destination_and_write_every_source() -> Result<(), StartError> {\n".to_owned();
    out += &harness(skeleton, &skeleton.ports, false);
    let _ = writeln!(out, "        let mut partition = harness.start::<{}>()?;", skeleton.type_name);
    for port in destinations {
        let call = if matches!(port.role, Role::QueuingDestination { .. }) { "send" } else { "write" };
        let value = match port.content {
            super::skeleton::Content::Message(message) => format!("{}::default()", message.name()),
            super::skeleton::Content::Bytes(size) => format!("Bytes{size}([0; {size}])"),
        };
        let _ = writeln!(out, "        {}.{call}(&{value});", port.field);
    }
    out += if queues {
        "        (0..SEND_EVERY).for_each(|_| partition.window());\n"
    } else {
        "        partition.window();\n"
    };
    for port in sources {
        let call = if port.role == Role::QueuingSource { "receive" } else { "read" };
        let _ = writeln!(out, "        assert!({}.{call}().is_some());", port.field);
    }
    out + "        Ok(())\n    }\n"
}

fn retained_test(skeleton: &Skeleton) -> String {
    let mut out =
        "\n    #[test]\n    fn what_is_kept_outlives_a_warm_restart() -> Result<(), StartError> {\n"
            .to_owned();
    out += &harness(skeleton, &skeleton.ports, true);
    let kind = &skeleton.type_name;
    let _ = write!(
        out,
        "        let mut first = harness.start::<{kind}>()?;\n        first.window();\n        first.window();\n        \
         drop(first);\n"
    );
    if skeleton.standby {
        let _ = write!(
            out,
            "        let mut second = harness.start::<{kind}>()?;\n        \
             assert_eq!(second.partition.kept.windows, 2);\n        \
             // One that stood by has to look again.\n        \
             second.partition.kept = Kept::default();\n        second.take_over();\n"
        );
    } else {
        let _ = writeln!(out, "        let second = harness.start::<{kind}>()?;");
    }
    out + "        assert_eq!(second.partition.kept.windows, 2);\n        Ok(())\n    }\n"
}

/// The surroundings. `held`: the far ends are not used.
fn harness(skeleton: &Skeleton, ports: &[SkeletonPort], held: bool) -> String {
    let mut out = format!("        let mut harness = Harness::new({:?})?;\n", skeleton.partition);
    if let Some(bytes) = skeleton.retained_bytes {
        let _ = writeln!(out, "        harness.retained({})?;", grouped(&bytes.to_string()));
    }
    for port in ports {
        let more = match port.role {
            Role::SamplingDestination { refresh_ns } => format!(", {}", grouped(&refresh_ns.to_string())),
            Role::QueuingDestination { depth } => format!(", {depth}"),
            Role::QueuingSource => format!(", {TEST_DEPTH}"),
            Role::SamplingSource => String::new(),
        };
        let name = if held { format!("_{}", port.field) } else { format!("mut {}", port.field) };
        let call = format!(
            "harness.{}::<{}>({:?}{more})?;",
            port_call(port.role),
            port.content.type_name(),
            port.name
        );
        let line = format!("        let {name} = {call}\n");
        // Two letters less than elsewhere: so many are left to a chain of calls that ends with `?`.
        if line.len() < WIDTH {
            out += &line;
        } else {
            let _ = write!(out, "        let {name} =\n            {call}\n");
        }
    }
    out
}
