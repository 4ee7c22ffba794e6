//! The error measures Err, Err′ and Err″ (Nirenstein and Blake 2004, sections 3.3–3.5; Nirenstein 2003,
//! section 4.1.3).
//!
//! A measure is the difference between the cubes at the corners of a rectangle, from 0 (equal) to 1. Uniform
//! sampling does not compare cubes.

use sightline_model::ErrorMeasure;
use sightline_model::VisibilitySample;

/// Computes the measure over two to four samples. Fewer than two samples have the measure 0.
pub fn error(measure: ErrorMeasure, samples: &[&VisibilitySample]) -> f64 {
    if samples.len() < 2 {
        return 0.0;
    }
    match measure {
        // With one stratum Err″ equals Err.
        ErrorMeasure::Sets | ErrorMeasure::Strata => stratified(samples),
        ErrorMeasure::Pixels => strict(samples),
        // The value exceeds every threshold, so every rectangle is split.
        ErrorMeasure::Uniform => f64::INFINITY,
    }
}

/// Computes Err″ (Nirenstein and Blake 2004, equation 3): the maximum over the strata k of 1 − min over i of
/// |∩ s_j(k)| / |s_i(k)|.
///
/// A sample that sees no triangle in a stratum has no ratio there. If other samples see triangles in it, the
/// intersection is empty and the measure is 1. If no sample does, the stratum counts as equal.
fn stratified(samples: &[&VisibilitySample]) -> f64 {
    let mut common = [0u32; 32];
    let mut sizes = [[0u32; 32]; 4];
    let mut at = [0usize; 4];
    // One pass over the sorted ids of all samples at once.
    while let Some(id) = samples
        .iter()
        .zip(at)
        .filter_map(|(s, i)| s.ids.get(i))
        .min()
        .copied()
    {
        let mut all = u32::MAX;
        for ((s, i), size) in samples.iter().zip(&mut at).zip(&mut sizes) {
            let mask = if s.ids.get(*i) == Some(&id) {
                *i += 1;
                s.strata[*i - 1]
            } else {
                0
            };
            all &= mask;
            each_bit(mask, |k| size[k] += 1);
        }
        each_bit(all, |k| common[k] += 1);
    }
    let mut worst = 0.0f64;
    for size in &sizes[..samples.len()] {
        for k in 0..32 {
            if size[k] > 0 {
                worst = worst.max(1.0 - f64::from(common[k]) / f64::from(size[k]));
            }
        }
    }
    worst
}

fn each_bit(mut mask: u32, mut f: impl FnMut(usize)) {
    while mask != 0 {
        f(mask.trailing_zeros() as usize);
        mask &= mask - 1;
    }
}

/// Computes Err′ (Nirenstein and Blake 2004, equation 2): the fraction of pixels whose triangle differs
/// between samples.
///
/// Samples without pixels count as entirely different. Cubes with the parameters of
/// [`sightline_trace::CubeSpec::new`] have pixels.
fn strict(samples: &[&VisibilitySample]) -> f64 {
    let Some(pixels) = samples
        .iter()
        .map(|s| s.pixels.as_deref())
        .collect::<Option<Vec<_>>>()
    else {
        debug_assert!(false, "Err′ needs samples with pixels");
        return 1.0;
    };
    let n = pixels[0].len();
    let different = (0..n)
        .filter(|i| pixels.iter().any(|p| p.get(*i) != pixels[0].get(*i)))
        .count();
    different as f64 / n as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(ids: &[u32], strata: &[u32]) -> VisibilitySample {
        VisibilitySample {
            ids: ids.into(),
            strata: strata.into(),
            ..Default::default()
        }
    }

    #[test]
    fn err_is_zero_for_equal_and_one_for_disjoint_sets() {
        let a = sample(&[1, 2, 3], &[1, 1, 1]);
        let b = sample(&[4, 5], &[1, 1]);
        assert_eq!(error(ErrorMeasure::Sets, &[&a, &a, &a, &a]), 0.0);
        assert_eq!(error(ErrorMeasure::Sets, &[&a, &b]), 1.0);
    }

    #[test]
    fn err_is_one_minus_minimum_ratio() {
        // The common set is {1, 2}; the ratios are 2/4, 2/2, 2/3.
        let a = sample(&[1, 2, 3, 4], &[1; 4]);
        let b = sample(&[1, 2], &[1; 2]);
        let c = sample(&[1, 2, 9], &[1; 3]);
        assert_eq!(error(ErrorMeasure::Sets, &[&a, &b, &c]), 0.5);
    }

    #[test]
    fn measure_is_maximum_over_strata() {
        // Stratum 0 is equal; stratum 1 has one of two in common.
        let a = sample(&[1, 2, 3], &[0b01, 0b10, 0b10]);
        let b = sample(&[1, 2], &[0b01, 0b10]);
        assert_eq!(error(ErrorMeasure::Strata, &[&a, &b]), 0.5);
        // Equal sets in other directions differ.
        let c = sample(&[1, 2, 3], &[0b10, 0b01, 0b10]);
        assert_eq!(error(ErrorMeasure::Strata, &[&a, &c]), 1.0);
    }

    #[test]
    fn empty_sample_equals_only_empty_sample() {
        let nothing = sample(&[], &[]);
        let a = sample(&[1], &[1]);
        assert_eq!(error(ErrorMeasure::Strata, &[&nothing, &nothing]), 0.0);
        assert_eq!(error(ErrorMeasure::Strata, &[&nothing, &a]), 1.0);
    }

    #[test]
    fn err_prime_counts_pixels() {
        let with = |pixels: &[u32]| VisibilitySample {
            pixels: Some(pixels.into()),
            ..Default::default()
        };
        let (a, b) = (with(&[1, 2, 3, 4]), with(&[1, 2, 4, 3]));
        assert_eq!(error(ErrorMeasure::Pixels, &[&a, &b, &a]), 0.5);
    }
}
