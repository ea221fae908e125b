//! A value over time in bounded memory: least and greatest of each stretch, so that no peak of a day's flight is lost.

/// Stretches kept, most; when there are more, neighbours become one.
const MOST: usize = 2000;

/// A stretch of values.
#[derive(Debug, Clone, Copy)]
struct Stretch {
    least: (f64, f64),
    greatest: (f64, f64),
    values: u64,
}

impl Stretch {
    fn of(point: (f64, f64)) -> Self {
        Self { least: point, greatest: point, values: 1 }
    }

    fn with(self, other: Self) -> Self {
        let least = if other.least.1 < self.least.1 { other.least } else { self.least };
        let greatest = if other.greatest.1 > self.greatest.1 { other.greatest } else { self.greatest };
        Self { least, greatest, values: self.values + other.values }
    }
}

/// A value over time.
#[derive(Debug, Clone)]
pub struct Envelope {
    stretches: Vec<Stretch>,
    /// Values of a whole stretch.
    values: u64,
}

impl Default for Envelope {
    fn default() -> Self {
        Self { stretches: Vec::new(), values: 1 }
    }
}

impl Envelope {
    /// Adds a value; times come in order.
    pub fn push(&mut self, time: f64, value: f64) {
        let new = Stretch::of((time, value));
        match self.stretches.last_mut().filter(|last| last.values < self.values) {
            Some(last) => *last = last.with(new),
            None => self.stretches.push(new),
        }
        if self.stretches.len() > MOST {
            self.stretches = self
                .stretches
                .chunks(2)
                .map(|two| two[1..].iter().fold(two[0], |all, each| all.with(*each)))
                .collect();
            self.values *= 2;
        }
    }

    /// Least and greatest of each stretch, in the order of their times.
    pub fn points(&self) -> Vec<(f64, f64)> {
        let mut points = Vec::with_capacity(2 * self.stretches.len());
        for stretch in &self.stretches {
            let (one, other) = (stretch.least, stretch.greatest);
            let (first, second) = if one.0 <= other.0 { (one, other) } else { (other, one) };
            points.push(first);
            if second.0 > first.0 {
                points.push(second);
            }
        }
        points
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn peak_of_a_long_flight_stays_and_memory_is_bounded() {
        let mut envelope = Envelope::default();
        for i in 0..1_000_000_u32 {
            envelope.push(f64::from(i), if i == 543_210 { 9.0 } else { f64::from(i % 7) * 0.1 });
        }
        let points = envelope.points();
        assert!(points.len() <= 2 * MOST && points.contains(&(543_210.0, 9.0)), "{}", points.len());
        assert!(points.windows(2).all(|pair| pair[0].0 < pair[1].0));
        assert_eq!(points.first().map(|point| point.0), Some(0.0));
    }

    #[test]
    fn few_values_stay_as_they_came() {
        let mut envelope = Envelope::default();
        assert!(envelope.points().is_empty());
        [(0.0, 1.0), (1.0, 3.0), (2.0, 2.0)].iter().for_each(|(time, value)| envelope.push(*time, *value));
        assert_eq!(envelope.points(), [(0.0, 1.0), (1.0, 3.0), (2.0, 2.0)]);
    }
}
