//! The time that a sampler needs for a given error: the lower envelope of its points, interpolated, and never
//! extrapolated.

use serde::Serialize;

/// The mean errors that the tables list.
pub const ERRORS: [f64; 5] = [0.01, 0.003, 0.001, 0.0003, 0.0001];

/// The number of seconds that a sampler needs for an error.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Needed {
    /// An interpolation between two measured points.
    Seconds(f64),
    /// The seconds of the fastest point with a lower error. No point with a higher error was measured, or an
    /// error or time is 0 and has no logarithm.
    AtMost(f64),
    /// No point reaches the error. The value is the time of the slowest point of the envelope.
    MoreThan(f64),
    /// No point was measured.
    Unknown,
}

impl Needed {
    /// Returns the text for tables.
    pub fn text(self) -> String {
        match self {
            Self::Seconds(s) => seconds(s),
            Self::AtMost(s) => format!("≤ {}", seconds(s)),
            Self::MoreThan(s) => format!("> {}", seconds(s)),
            Self::Unknown => "-".to_owned(),
        }
    }
}

/// The quotient of two times.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Ratio {
    /// Both times are known.
    Is(f64),
    /// A lower bound: the baseline needs more time than measured, or the other sampler less.
    AtLeast(f64),
}

impl Ratio {
    /// Returns the ratio, or its lower bound.
    pub fn least(self) -> f64 {
        match self {
            Self::Is(r) | Self::AtLeast(r) => r,
        }
    }

    /// Returns the text for tables.
    pub fn text(self) -> String {
        match self {
            Self::Is(r) => format!("{r:.2}"),
            // Round down, because this is a lower bound.
            Self::AtLeast(r) => format!("≥ {:.2}", (r * 100.0).floor() / 100.0),
        }
    }
}

/// Formats seconds with three digits, which is the precision of measured times.
pub fn seconds(s: f64) -> String {
    match s {
        s if s < 10.0 => format!("{s:.2}"),
        s if s < 100.0 => format!("{s:.1}"),
        s => format!("{s:.0}"),
    }
}

/// Returns the lower envelope of the points (seconds, error), fastest first. A point belongs to the envelope
/// only if no faster point has an equal or lower error, so errors fall strictly.
pub fn envelope(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let mut sorted = points.to_vec();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let mut kept: Vec<(f64, f64)> = Vec::new();
    for point in sorted {
        if kept.last().is_none_or(|last| point.1 < last.1) {
            kept.push(point);
        }
    }
    kept
}

/// Returns the seconds that a sampler with these points needs for `error`, interpolated between logarithms.
pub fn needed(points: &[(f64, f64)], error: f64) -> Needed {
    let kept = envelope(points);
    // Errors fall, so the first sufficient point directly follows the last insufficient one.
    let Some(i) = kept.iter().position(|p| p.1 <= error) else {
        return kept
            .last()
            .map_or(Needed::Unknown, |slowest| Needed::MoreThan(slowest.0));
    };
    let (s, e) = kept[i];
    if e >= error {
        return Needed::Seconds(s);
    }
    match i.checked_sub(1).map(|before| kept[before]) {
        // An error of 0 has no logarithm to interpolate to.
        Some((faster, worse)) if e > 0.0 && faster > 0.0 => {
            let share = (worse / error).ln() / (worse / e).ln();
            Needed::Seconds((faster.ln() + share * (s / faster).ln()).exp())
        }
        _ => Needed::AtMost(s),
    }
}

/// Returns the time of the baseline as a multiple of the other time, or `None` if not even a lower bound is
/// known.
pub fn ratio(baseline: Needed, other: Needed) -> Option<Ratio> {
    match (baseline, other) {
        (Needed::Seconds(b), Needed::Seconds(o)) if o > 0.0 => Some(Ratio::Is(b / o)),
        (Needed::Seconds(b) | Needed::MoreThan(b), Needed::Seconds(o) | Needed::AtMost(o))
            if o > 0.0 =>
        {
            Some(Ratio::AtLeast(b / o))
        }
        _ => None,
    }
}

/// Returns the geometric mean, which is a lower bound if a ratio is a lower bound. Returns `None` without
/// ratios.
pub fn geometric_mean(ratios: &[Ratio]) -> Option<Ratio> {
    let sum: f64 = ratios.iter().map(|r| r.least().ln()).sum();
    let mean = (sum / ratios.len() as f64).exp();
    let known = ratios.iter().all(|r| matches!(r, Ratio::Is(_)));
    (!ratios.is_empty()).then_some(if known {
        Ratio::Is(mean)
    } else {
        Ratio::AtLeast(mean)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn assert_seconds(n: Needed, expected: f64) {
        assert!(
            matches!(n, Needed::Seconds(s) if (s / expected - 1.0).abs() < 1e-12),
            "{n:?}, not {expected}"
        );
    }

    #[test]
    fn power_law_is_interpolated_exactly() {
        // The error is 0.1 / seconds^2.
        let points: Vec<_> = [1.0, 3.0, 10.0, 50.0]
            .iter()
            .map(|&s| (s, 0.1 / (s * s)))
            .collect();
        for error in [0.05, 0.01, 0.003, 0.001, 0.0001] {
            assert_seconds(needed(&points, error), f64::sqrt(0.1 / error));
        }
    }

    #[test]
    fn needed_does_not_extrapolate() {
        let points = [(1.0, 0.01), (10.0, 0.001)];
        assert_eq!(needed(&points, 0.000_999), Needed::MoreThan(10.0));
        assert_eq!(needed(&points, 0.02), Needed::AtMost(1.0));
        assert_eq!(needed(&points, 0.01), Needed::Seconds(1.0));
        assert_eq!(needed(&points, 0.001), Needed::Seconds(10.0));
        assert_eq!(needed(&[], 0.01), Needed::Unknown);
        assert_eq!(needed(&[(2.0, 0.01)], 0.01), Needed::Seconds(2.0));
        assert_eq!(needed(&[(2.0, 0.01)], 0.1), Needed::AtMost(2.0));
        assert_eq!(needed(&[(2.0, 0.01)], 0.001), Needed::MoreThan(2.0));
        // A slower point with a higher error adds no information.
        assert_eq!(
            needed(&[(1.0, 0.01), (3.0, 0.02)], 0.001),
            Needed::MoreThan(1.0)
        );
    }

    #[test]
    fn envelope_excludes_points_no_better_than_faster_ones() {
        // The points are slower and worse, slower and equal, or as fast and worse, in no order.
        let points = [
            (10.0, 0.001),
            (2.0, 0.02),
            (1.0, 0.01),
            (11.0, 0.001),
            (10.0, 0.005),
            (5.0, 0.01),
        ];
        assert_eq!(envelope(&points), [(1.0, 0.01), (10.0, 0.001)]);
        assert_seconds(needed(&points, f64::sqrt(1e-5)), f64::sqrt(10.0));
    }

    #[test]
    fn zero_error_is_not_interpolated() {
        let points = [(1.0, 0.01), (4.0, 0.0)];
        assert_eq!(needed(&points, 0.001), Needed::AtMost(4.0));
        assert_eq!(needed(&points, 0.01), Needed::Seconds(1.0));
    }

    #[test]
    fn ratios_keep_bounds_and_means_are_geometric() {
        use Needed::{AtMost, MoreThan, Seconds, Unknown};
        assert_eq!(ratio(Seconds(6.0), Seconds(2.0)), Some(Ratio::Is(3.0)));
        for (baseline, other) in [
            (Seconds(6.0), AtMost(2.0)),
            (MoreThan(6.0), Seconds(2.0)),
            (MoreThan(6.0), AtMost(2.0)),
        ] {
            assert_eq!(ratio(baseline, other), Some(Ratio::AtLeast(3.0)));
        }
        // The baseline may need less time, or the other sampler more.
        for (baseline, other) in [
            (AtMost(6.0), Seconds(2.0)),
            (Seconds(6.0), MoreThan(2.0)),
            (MoreThan(6.0), MoreThan(2.0)),
            (Unknown, Seconds(2.0)),
            (Seconds(6.0), Unknown),
        ] {
            assert_eq!(ratio(baseline, other), None);
        }
        let mean = |ratios: &[Ratio]| geometric_mean(ratios).unwrap();
        assert!(
            matches!(mean(&[Ratio::Is(2.0), Ratio::Is(8.0)]), Ratio::Is(m) if (m - 4.0).abs() < 1e-12)
        );
        assert!(matches!(
            mean(&[Ratio::Is(2.0), Ratio::AtLeast(8.0)]),
            Ratio::AtLeast(m) if (m - 4.0).abs() < 1e-12
        ));
        assert_eq!(geometric_mean(&[]), None);
        assert_eq!(
            [Ratio::Is(2.559), Ratio::AtLeast(2.559)].map(Ratio::text),
            ["2.56", "≥ 2.55"]
        );
    }
}
