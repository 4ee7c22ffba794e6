//! A logarithmic axis of the curves.

/// A logarithmic axis over whole decades.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Axis {
    /// The lower and the upper end, as exponents of ten.
    least: i32,
    most: i32,
    /// The positions of the lower and the upper end in the drawing, in pixels.
    from: f64,
    to: f64,
}

impl Axis {
    /// Creates an axis over the positive finite values. Without such values, the axis covers one decade.
    pub fn over(values: impl Iterator<Item = f64> + Clone, from: f64, to: f64) -> Self {
        let logs = values.filter(|v| *v > 0.0 && v.is_finite()).map(f64::log10);
        let low = logs.clone().fold(f64::INFINITY, f64::min);
        let high = logs.fold(f64::NEG_INFINITY, f64::max);
        if low > high {
            return Self {
                least: 0,
                most: 1,
                from,
                to,
            };
        }
        let least = low.floor() as i32;
        Self {
            least,
            most: (high.ceil() as i32).max(least + 1),
            from,
            to,
        }
    }

    /// Returns the position of a value. Values without a logarithm are at the lower end.
    pub fn at(&self, value: f64) -> f64 {
        let (least, most) = (f64::from(self.least), f64::from(self.most));
        let log = if value > 0.0 {
            value.log10().clamp(least, most)
        } else {
            least
        };
        self.from + (log - least) / (most - least) * (self.to - self.from)
    }

    /// Returns the decades as powers of ten, and the values that are 2 to 9 times a decade.
    pub fn ticks(&self) -> (Vec<i32>, Vec<f64>) {
        let decades = self.least..self.most;
        let minor = decades.flat_map(|d| (2..10).map(move |k| f64::from(k) * 10f64.powi(d)));
        ((self.least..=self.most).collect(), minor.collect())
    }
}

/// Returns a power of ten as text: as 0.1 or 1000 for exponents from −5 to 5, and as 1e6 otherwise.
pub fn decade(power: i32) -> String {
    match power {
        -5..=-1 => format!("{:.*}", power.unsigned_abs() as usize, 10f64.powi(power)),
        0..=5 => format!("{:.0}", 10f64.powi(power)),
        _ => format!("1e{power}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_are_whole_decades() {
        let axis = Axis::over([0.3, 40.0, 0.0].into_iter(), 0.0, 300.0);
        assert_eq!((axis.least, axis.most), (-1, 2));
        assert!((axis.at(1.0) - 100.0).abs() < 1e-9);
        assert_eq!(axis.at(0.0), 0.0);
        assert_eq!(
            axis.ticks().0.into_iter().map(decade).collect::<Vec<_>>(),
            ["0.1", "1", "10", "100"]
        );
        let flat = Axis::over([10.0].into_iter(), 0.0, 1.0);
        assert_eq!((flat.least, flat.most), (1, 2));
    }
}
