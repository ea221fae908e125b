//! What the module does about faults. Build the programs first: `cargo build --release`.

use faults::run;

/// The entries of a health log about a partition's error.
fn entries<'l>(log: &'l str, partition: &str, error: &str) -> Vec<&'l str> {
    let has = |line: &&str| {
        line.contains(&format!("\"partition\":\"{partition}\""))
            && line.contains(&format!("\"error\":\"{error}\""))
    };
    log.lines().filter(has).collect()
}

#[test]
fn without_faults_the_inlet_is_opened_and_no_error_is_in_the_log() -> Result<(), String> {
    let (said, health) = run("no-fault", &[])?;
    assert!(said.contains("watch: opens the inlet"), "{said}");
    assert!(!health.contains("\"error\":\"killed\""), "{health}");
    Ok(())
}

#[test]
fn killed_sensor_is_started_again_and_the_watch_goes_on() -> Result<(), String> {
    let (said, health) = run("killed-sensor", &["--kill", "sensor@1"])?;
    let killed = entries(&health, "sensor", "killed");
    assert_eq!(killed.len(), 1, "{health}");
    assert!(killed[0].contains("\"action\":\"warm_restart\""), "{health}");
    assert!(said.contains("watch: opens the inlet"), "{said}");
    Ok(())
}

#[test]
fn stopped_sensor_closes_the_inlet() -> Result<(), String> {
    let (said, _) = run("stopped-sensor", &["--stop", "sensor@1"])?;
    assert!(said.contains("watch: no measurement: the inlet is closed"), "{said}");
    Ok(())
}
