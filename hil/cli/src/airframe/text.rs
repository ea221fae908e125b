//! The facts for a person.

use std::fmt::Write;

use super::facts::{Facts, ModeRow};

/// The whole report.
pub(super) fn report(facts: &Facts) -> String {
    let mut out = String::new();
    // Writing to a text cannot fail.
    let _ = head(&mut out, facts);
    let _ = trims(&mut out, facts);
    let _ = modes(&mut out, facts);
    let _ = gains(&mut out, facts);
    let _ = limits(&mut out, facts);
    out
}

fn head(out: &mut String, facts: &Facts) -> std::fmt::Result {
    writeln!(out, "{}", facts.name)?;
    for source in &facts.sources {
        writeln!(out, "  from {source}")?;
    }
    writeln!(
        out,
        "  {} kg, {:.0} N/m², aspect ratio {:.1}; at {} m above sea level, {:.3} kg/m³",
        facts.mass_kg, facts.wing_loading_npm2, facts.aspect_ratio, facts.height_m, facts.density_kgpm3
    )
}

fn trims(out: &mut String, facts: &Facts) -> std::fmt::Result {
    let stall = &facts.stall;
    writeln!(
        out,
        "\nlevel flight: stalls at {:.1} m/s (C_L {:.2} at {:.1}°)",
        stall.airspeed_mps, stall.lift_coefficient, stall.alpha_deg
    )?;
    if let Some([slowest, fastest]) = facts.speed_range_mps {
        writeln!(out, "  trims from {slowest:.1} to {fastest:.1} m/s")?;
    }
    writeln!(out, "  airspeed    alpha   elevator   throttle   climb at full throttle")?;
    for row in &facts.trims {
        writeln!(
            out,
            "{:6.1} m/s {:7.2}° {:9.2}° {:10.3} {:13.1} m/s",
            row.airspeed_mps, row.alpha_deg, row.elevator_deg, row.throttle, row.climb_mps
        )?;
    }
    Ok(())
}

fn modes(out: &mut String, facts: &Facts) -> std::fmt::Result {
    writeln!(out, "\nmodes at {} m/s", facts.airspeed_mps)?;
    if let Some(error) = &facts.trim_error {
        return writeln!(out, "  none: {error}");
    }
    writeln!(out, "                    roots, 1/s       frequency   damping   time to 1/e")?;
    facts.modes.iter().try_for_each(|mode| {
        // One real root has nothing to tell but its time.
        let swing = match mode.roots.len() {
            1 => format!("{:25}", ""),
            _ => format!("{:9.3} rad/s {:9.2}", mode.frequency_radps, mode.damping),
        };
        writeln!(out, "  {:12} {:>18} {swing} {}", mode.name, roots(mode), time(mode.time_constant_s))
    })
}

fn roots(mode: &ModeRow) -> String {
    match mode.roots.as_slice() {
        [[re, im], _] if *im != 0.0 => format!("{re:.3} ± {:.3} i", im.abs()),
        [[a, _], [b, _]] => format!("{a:.3}, {b:.3}"),
        [[re, _]] => format!("{re:.3}"),
        _ => String::new(),
    }
}

fn time(seconds: f64) -> String {
    if seconds >= 0.0 { format!("{seconds:10.2} s") } else { format!("{:10.2} s, growing", -seconds) }
}

fn gains(out: &mut String, facts: &Facts) -> std::fmt::Result {
    let g = &facts.gains;
    writeln!(out, "\ngains of the Controller at {} m/s", facts.airspeed_mps)?;
    let n = &g.normal;
    writeln!(out, "  normal    K_Q {:.4}  K_C {:.5}  K_E {:.5}  N_C {:.5}", n.k_q, n.k_c, n.k_e, n.n_c)?;
    writeln!(
        out,
        "            for {:.1} rad/s at a damping of {:.2}, and a pole at {:.1} rad/s",
        n.frequency_radps, n.damping, n.pole_radps
    )?;
    writeln!(out, "  lateral   K_R {:.4}  K_B {:.4}", g.lateral.k_r, g.lateral.k_b)?;
    writeln!(
        out,
        "  axial     K_A {:.4}  K_EA {:.4}  where full throttle is worth {:.2} m/s²",
        g.axial.k_a, g.axial.k_ea, g.axial.k_t
    )?;
    let r = &g.roll;
    writeln!(out, "  roll      K_P {:.4}  K_EP {:.4}  N_P {:.4}", r.k_p, r.k_ep, r.n_p)?;
    let [fast, slow] = r.poles_radps;
    writeln!(out, "            for poles at {fast:.1} and {slow:.1} rad/s")
}

fn limits(out: &mut String, facts: &Facts) -> std::fmt::Result {
    let l = &facts.limits;
    writeln!(out, "\nlimits at {} m/s", facts.airspeed_mps)?;
    match (l.normal_zero_radps, l.normal_frequency_within) {
        (Some(zero), Some(within)) => {
            let verdict = if within { "keeps within" } else { "is ABOVE" };
            writeln!(
                out,
                "  normal loop     zeros at ±{zero:.1} rad/s: its {:.1} rad/s {verdict} a third of that",
                facts.gains.normal.frequency_radps
            )?;
        }
        _ => writeln!(out, "  normal loop     no zero bounds it")?,
    }
    writeln!(
        out,
        "  load factor     {:.1} by the wing, {:.1} by the elevator, {:.2} asked for at most",
        l.load_factor_by_lift, l.load_factor_by_elevator, l.load_factor_asked
    )?;
    writeln!(
        out,
        "  bank            {:.0}° held level, {:.0}° asked for at most",
        l.bank_deg, l.bank_asked_deg
    )?;
    writeln!(
        out,
        "  airspeed        {:.1} m/s at least, or the nose goes down; {:.1} to {:.1} m/s asked for",
        l.floor_mps, l.slowest_mps, l.fastest_mps
    )?;
    writeln!(out, "  roll rate       {:.0}°/s at full aileron", l.roll_rate_degps)?;
    for (index, corner) in l.corners.iter().enumerate() {
        let what = if index == 0 { "corners" } else { "" };
        let wide = match corner.bank_deg > l.bank_asked_deg {
            true => ", which is not asked for: flown wider",
            false => "",
        };
        writeln!(
            out,
            "  {what:15} {:.0} m with {} m/s of wind, {:.0}° of bank with it behind{wide}",
            corner.radius_m, corner.wind_mps, corner.bank_deg
        )?;
    }
    Ok(())
}
