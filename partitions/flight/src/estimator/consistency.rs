//! Whether the filter is right about its own errors: on noise that is exactly what it assumes, normalised innovations and
//! normalised estimation errors have to lie within the bounds of their χ² distributions, from both sides. That shows
//! the equations (transition, delayed fixes, sequential scalars, considered states, Joseph form), not the tuning; how
//! the tuning fits the plant's sensors shows `tests/consistency.rs`.

use super::world::{DT_S, World, config};
use super::*;

/// Flights; a seed each.
const FLIGHTS: u64 = 200;
const FLIGHT_S: f64 = 60.0;

/// The error state (real less estimated) as the filter defines it, without the wind.
fn error(real: &Nominal, estimated: &Nominal) -> ErrorVector {
    let mut error = ErrorVector::zeros();
    let mut set = |at: usize, v: Vector3<f64>| error.fixed_rows_mut::<3>(at).copy_from(&v);
    set(ATT, (real.attitude * estimated.attitude.inverse()).scaled_axis());
    set(VEL, real.velocity - estimated.velocity);
    set(POS, real.position - estimated.position);
    set(GYRO, real.gyro_bias - estimated.gyro_bias);
    set(ACCEL, real.accel_bias - estimated.accel_bias);
    set(MAG, real.mag_bias - estimated.mag_bias);
    error
}

/// Normalised squared error of a block of states.
fn nees(estimator: &Estimator, real: &Nominal, at: usize, count: usize) -> f64 {
    let e = error(real, &estimator.filter.nominal);
    let p = estimator.filter.covariance.view((at, at), (count, count)).into_owned();
    let e = e.rows(at, count).into_owned();
    p.cholesky().map_or(f64::NAN, |p| e.dot(&p.solve(&e)))
}

/// Whether a sum of squares of `n` unit normals is what chance allows in one of some ten thousand cases on either side
/// (Wilson and Hilferty's approximation of χ²).
fn within_chi_square(sum: f64, n: f64) -> bool {
    let z = ((sum / n).cbrt() - (1.0 - 2.0 / (9.0 * n))) / (2.0 / (9.0 * n)).sqrt();
    z.abs() < 3.9
}

#[test]
fn errors_and_innovations_are_as_large_as_the_filter_says_on_the_noise_that_it_assumes() {
    for pressure in [true, false] {
        let mut innovations = [(0.0, 0.0); Aid::ALL.len()];
        let blocks = [
            ("attitude", ATT, 3),
            ("velocity", VEL, 3),
            ("position", POS, 3),
            ("gyroscope bias", GYRO, 3),
            ("accelerometer bias", ACCEL, 3),
            ("magnetometer bias", MAG, 3),
            ("all but the wind", 0, 18),
        ];
        let mut errors = vec![0.0; blocks.len()];
        for seed in 0..FLIGHTS {
            let mut world = World::new(seed, config(pressure));
            let mut estimator = world.estimator();
            for _ in 0..(FLIGHT_S / DT_S) as u32 {
                let sample = world.step();
                estimator.predict(&sample);
                world.measure(&mut estimator, 0.12);
            }
            assert_eq!(estimator.counters().refused, 0, "seed {seed}");
            for (sum, aid) in innovations.iter_mut().zip(Aid::ALL) {
                let of = estimator.innovations(aid);
                *sum = (sum.0 + of.squares, sum.1 + of.count as f64);
            }
            for (sum, (_, at, count)) in errors.iter_mut().zip(&blocks) {
                *sum += nees(&estimator, &world.real.nominal, *at, *count);
            }
        }
        for (aid, (squares, count)) in Aid::ALL.iter().zip(innovations).filter(|(_, (_, count))| *count > 0.0)
        {
            println!("{aid:?}: {:.4} of {count}", squares / count);
        }
        for ((name, _, count), sum) in blocks.iter().zip(&errors) {
            println!("{name}: {:.3} of {count}", sum / FLIGHTS as f64);
        }
        for (aid, (squares, count)) in Aid::ALL.iter().zip(innovations).filter(|(_, (_, count))| *count > 0.0)
        {
            assert!(within_chi_square(squares, count), "{aid:?}: {} over {count}", squares / count);
        }
        for ((name, _, count), sum) in blocks.iter().zip(errors) {
            let n = (count * FLIGHTS as usize) as f64;
            assert!(within_chi_square(sum, n), "{name}: {} of {count}", sum / FLIGHTS as f64);
        }
    }
}
