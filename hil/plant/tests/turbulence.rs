//! The gusts' spectra against those of MIL-F-8785C.
//!
//! Each spectrum is estimated from a long passage at one height and airspeed (Hann windows, periodograms averaged over windows
//! and over a band of frequencies) and compared with the average of the formula over the same frequencies.

use bateleur_plant::wind::{AirMotion, Passage, Spectrum, Wind};
use bateleur_plant::{STEP_S, Turbulence};
use nalgebra::Rotation3;
use std::f64::consts::{PI, TAU};

const HEIGHT_M: f64 = 160.0;
const AIRSPEED_MPS: f64 = 22.0;
const SPAN_M: f64 = 2.8956;
/// Samples in a window.
const LENGTH: usize = 4096;
/// Frequencies looked at in a band, at most.
const MOST_LINES: usize = 12;

/// A spectrum as a formula, one-sided, per Hz.
type Formula = fn(f64, &Spectrum) -> f64;

/// Path frequency, rad/m, at a frequency in Hz; spectra per rad/m times this slope are spectra per Hz.
const PER_HZ: f64 = TAU / AIRSPEED_MPS;

fn along(f: f64, s: &Spectrum) -> f64 {
    let (l, sigma) = (s.horizontal_scale_m, s.horizontal_sigma_mps);
    PER_HZ * sigma * sigma * 2.0 * l / PI / (1.0 + (l * PER_HZ * f).powi(2))
}

fn transverse(f: f64, l: f64, sigma: f64) -> f64 {
    let x = (l * PER_HZ * f).powi(2);
    PER_HZ * sigma * sigma * l / PI * (1.0 + 3.0 * x) / (1.0 + x).powi(2)
}

fn across(f: f64, s: &Spectrum) -> f64 {
    transverse(f, s.horizontal_scale_m, s.horizontal_sigma_mps)
}

fn vertical(f: f64, s: &Spectrum) -> f64 {
    transverse(f, s.vertical_scale_m, s.vertical_sigma_mps)
}

fn rolling(f: f64, s: &Spectrum) -> f64 {
    let l = s.vertical_scale_m;
    let size = s.vertical_sigma_mps.powi(2) / l * 0.8 * (PI * l / (4.0 * SPAN_M)).cbrt();
    PER_HZ * size / (1.0 + (4.0 * SPAN_M / PI * PER_HZ * f).powi(2))
}

fn pitching(f: f64, s: &Spectrum) -> f64 {
    let path = PER_HZ * f;
    path * path / (1.0 + (4.0 * SPAN_M / PI * path).powi(2)) * vertical(f, s)
}

fn yawing(f: f64, s: &Spectrum) -> f64 {
    let path = PER_HZ * f;
    path * path / (1.0 + (3.0 * SPAN_M / PI * path).powi(2)) * across(f, s)
}

/// Power at one line of a window, one-sided, per Hz.
fn power(samples: &[f64], line: usize, step_s: f64) -> f64 {
    let (turn_sin, turn_cos) = (TAU * line as f64 / LENGTH as f64).sin_cos();
    let (mut cos, mut sin, mut re, mut im) = (1.0, 0.0, 0.0, 0.0);
    for sample in samples {
        re += sample * cos;
        im += sample * sin;
        (cos, sin) = (cos * turn_cos - sin * turn_sin, sin * turn_cos + cos * turn_sin);
    }
    // A Hann window has a mean square of 3/8.
    2.0 * step_s * (re * re + im * im) / (0.375 * LENGTH as f64)
}

/// Lines of a band, evenly spread where there are more than needed.
fn lines(band: (f64, f64), step_s: f64) -> Vec<usize> {
    let resolution = 1.0 / (LENGTH as f64 * step_s);
    let (low, high) = ((band.0 / resolution).ceil() as usize, (band.1 / resolution) as usize);
    let stride = ((high - low) / MOST_LINES).max(1);
    (low.max(2)..=high).step_by(stride).collect()
}

/// Mean power in bands of all six components of the air's motion.
/// From so many windows, of samples so many plant steps apart.
fn estimated(bands: &[(f64, f64)], windows: usize, steps: usize) -> Vec<[f64; 6]> {
    let step_s = STEP_S * steps as f64;
    let passage = Passage { height_m: HEIGHT_M, airspeed_mps: AIRSPEED_MPS, to_body: Rotation3::identity() };
    // Wind from the south: the longitudinal gust lies along north, the body's forward axis.
    let mut wind = Wind::new(7, 5.0, PI, Turbulence::Moderate, true, SPAN_M);
    let hann: Vec<f64> = (0..LENGTH).map(|i| 0.5 - 0.5 * (TAU * i as f64 / LENGTH as f64).cos()).collect();
    let mut sums = vec![[0.0; 6]; bands.len()];
    for _ in 0..windows {
        let mut columns = vec![Vec::new(); 6];
        for weight in &hann {
            (1..steps).for_each(|_| _ = wind.step(&passage, STEP_S));
            let AirMotion { gust_ned, rates_body, .. } = wind.step(&passage, STEP_S);
            let row = gust_ned.iter().chain(rates_body.iter());
            row.zip(&mut columns).for_each(|(value, column)| column.push(value * weight));
        }
        for (band, sum) in bands.iter().zip(&mut sums) {
            let lines = lines(*band, step_s);
            for (column, total) in columns.iter().zip(sum.iter_mut()) {
                let all: f64 = lines.iter().map(|line| power(column, *line, step_s)).sum();
                *total += all / (lines.len() * windows) as f64;
            }
        }
    }
    sums
}

fn assert_spectra(bands: &[(f64, f64)], windows: usize, steps: usize, room: f64) {
    let step_s = STEP_S * steps as f64;
    let spectrum = Spectrum::low_altitude(Turbulence::Moderate, HEIGHT_M);
    let formulas: [(&str, Formula); 6] = [
        ("along", along),
        ("across", across),
        ("vertical", vertical),
        ("rolling", rolling),
        ("pitching", pitching),
        ("yawing", yawing),
    ];
    for (band, found) in bands.iter().zip(estimated(bands, windows, steps)) {
        let lines = lines(*band, step_s);
        for ((name, formula), is) in formulas.iter().zip(found) {
            let at = |line: &usize| formula(*line as f64 / (LENGTH as f64 * step_s), &spectrum);
            let should = lines.iter().map(at).sum::<f64>() / lines.len() as f64;
            println!("{name:9} {:6.3} to {:6.3} Hz: {:.3} of the formula", band.0, band.1, is / should);
            assert!(
                (is / should - 1.0).abs() < room,
                "{name} from {} to {} Hz: {is} against {should}",
                band.0,
                band.1
            );
        }
    }
}

#[test]
fn slow_gusts_have_the_spectra_of_the_specification() {
    // The corner of the horizontal gusts lies at V / 2πL = 0.012 Hz. Estimates of the lowest band scatter by 5 %.
    assert_spectra(&[(0.015, 0.03), (0.03, 0.07), (0.07, 0.2), (0.2, 0.5), (0.5, 1.0)], 150, 20, 0.15);
}

#[test]
fn fast_gusts_have_the_spectra_of_the_specification() {
    assert_spectra(&[(0.5, 1.0), (1.0, 2.5), (2.5, 6.0), (6.0, 15.0)], 400, 1, 0.10);
}
