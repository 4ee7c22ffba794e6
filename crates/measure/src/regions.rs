//! Connected regions of wrong pixels on the surface of a visibility cube (§7.2 of the paper, "CR").
//!
//! Pixels touch if they share a side, also across the edge between two faces. The cube is one closed surface,
//! so an edge does not split a hole into two regions. Three pixels that meet at a corner of the cube touch
//! one another.

/// The number and size of the regions in one frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Regions {
    /// The number of regions.
    pub count: u32,
    /// The number of pixels of the largest region; 0 without regions.
    pub largest: u32,
}

/// Finds the regions among 6·n·n pixels in the order of [`sightline_trace::CubeImage`]. `wrong` must have
/// that length.
pub fn regions(n: u32, wrong: &[bool]) -> Regions {
    let mut parent: Vec<u32> = (0..wrong.len() as u32).collect();
    for (i, _) in wrong.iter().enumerate().filter(|p| *p.1) {
        for neighbour in neighbours(n, i as u32) {
            // The loop visits each pair of neighbours twice, and one visit suffices.
            if neighbour < i as u32 && wrong[neighbour as usize] {
                let (a, b) = (root(&mut parent, i as u32), root(&mut parent, neighbour));
                parent[a.max(b) as usize] = a.min(b);
            }
        }
    }
    let mut size = vec![0u32; wrong.len()];
    let mut found = Regions::default();
    for i in (0..wrong.len()).filter(|&i| wrong[i]) {
        let root = root(&mut parent, i as u32);
        let size = &mut size[root as usize];
        found.count += u32::from(*size == 0);
        *size += 1;
        found.largest = found.largest.max(*size);
    }
    found
}

/// Returns the representative of a pixel's region, and halves the path to it.
fn root(parent: &mut [u32], mut i: u32) -> u32 {
    while parent[i as usize] != i {
        let above = parent[parent[i as usize] as usize];
        parent[i as usize] = above;
        i = above;
    }
    i
}

/// Returns the indices of the four pixels that share a side with pixel `i`: left, right, below, above on its
/// face.
pub fn neighbours(n: u32, i: u32) -> [u32; 4] {
    let (face, y, x) = (i / (n * n), i / n % n, i % n);
    let (x, y) = (i64::from(x), i64::from(y));
    [(x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)].map(|(x, y)| pixel(n, face, x, y))
}

/// Returns the pixel at (x, y) of a face, where one of the two coordinates may be one step off the face. In
/// that case, the function computes the direction of the position and returns the pixel of the face in that
/// direction. The computation uses integers, so that rounding cannot break an edge.
fn pixel(n: u32, face: u32, x: i64, y: i64) -> u32 {
    let m = i64::from(n);
    if (0..m).contains(&x) && (0..m).contains(&y) {
        return (face * n + y as u32) * n + x as u32;
    }
    // The direction times n, by the conventions of `sightline_trace::cube`.
    let axis = face as usize / 2;
    let mut direction = [0i64; 3];
    direction[axis] = if face.is_multiple_of(2) { m } else { -m };
    direction[(axis + 1) % 3] = 2 * x + 1 - m;
    direction[(axis + 2) % 3] = 2 * y + 1 - m;
    // One step off the face, exactly one component has the magnitude n + 1, the largest.
    let axis = (0..3).fold(0, |best, a| {
        if direction[a].abs() > direction[best].abs() {
            a
        } else {
            best
        }
    });
    let reach = direction[axis].abs();
    let to_pixel = |component: i64| ((component + reach) * m / (2 * reach)).clamp(0, m - 1) as u32;
    let face = axis as u32 * 2 + u32::from(direction[axis] < 0);
    (face * n + to_pixel(direction[(axis + 2) % 3])) * n + to_pixel(direction[(axis + 1) % 3])
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use proptest::prelude::Strategy;
    use sightline_trace::cube::face_basis;

    fn direction(n: u32, i: u32) -> Vec3 {
        let [forward, right, up] = face_basis(i / (n * n));
        let part = |p: u32| (2 * p + 1) as f32 / n as f32 - 1.0;
        (forward + right * part(i % n) + up * part(i / n % n)).normalize()
    }

    #[test]
    fn touching_is_symmetric_and_near() {
        for n in [1, 2, 3, 8, 13] {
            for i in 0..6 * n * n {
                for j in neighbours(n, i) {
                    assert!(j < 6 * n * n && j != i);
                    assert!(
                        neighbours(n, j).contains(&i),
                        "{i} touches {j}, not the reverse, n = {n}"
                    );
                    if n >= 8 {
                        let angle = direction(n, i).angle_between(direction(n, j));
                        assert!(
                            angle < 2.9 / n as f32,
                            "{i} and {j} are {angle} apart, n = {n}"
                        );
                    }
                }
                let mut distinct = neighbours(n, i).to_vec();
                distinct.sort_unstable();
                distinct.dedup();
                assert_eq!(distinct.len(), 4, "pixel {i}, n = {n}");
            }
        }
    }

    #[test]
    fn whole_cube_is_one_region() {
        for n in [1, 2, 7] {
            let all = vec![true; (6 * n * n) as usize];
            assert_eq!(
                regions(n, &all),
                Regions {
                    count: 1,
                    largest: 6 * n * n
                }
            );
            assert_eq!(regions(n, &vec![false; all.len()]), Regions::default());
        }
    }

    #[test]
    fn diagonals_do_not_touch_and_edges_do() {
        let n = 4;
        let mut wrong = vec![false; 96];
        // The two pixels are diagonal on face 0.
        wrong[0] = true;
        wrong[5] = true;
        assert_eq!(
            regions(n, &wrong),
            Regions {
                count: 2,
                largest: 1
            }
        );
        wrong[1] = true;
        assert_eq!(
            regions(n, &wrong),
            Regions {
                count: 1,
                largest: 3
            }
        );
        // Face 0 looks along +x and its right vector is +y. Its right border touches face 2 (+y), whose up
        // vector is +x.
        let mut wrong = vec![false; 96];
        wrong[(2 * n + 3) as usize] = true;
        let across = neighbours(n, 2 * n + 3)[1];
        assert_eq!(across / (n * n), 2);
        assert_eq!(
            (across / n % n, across % n),
            (3, 2),
            "top row (+x), as far along z as before"
        );
        wrong[across as usize] = true;
        assert_eq!(
            regions(n, &wrong),
            Regions {
                count: 1,
                largest: 2
            }
        );
    }

    #[test]
    fn three_pixels_meet_at_a_corner_of_the_cube() {
        let n = 5;
        // At the corner (+, +, +) is the last pixel of the faces +x, +y and +z.
        let corner = |face: u32| face * n * n + n * n - 1;
        let mut wrong = vec![false; 150];
        for face in [0, 2, 4] {
            wrong[corner(face) as usize] = true;
        }
        assert_eq!(
            regions(n, &wrong),
            Regions {
                count: 1,
                largest: 3
            }
        );
    }
    /// Computes the regions by flooding, the paper's "recursive search".
    fn flooded(n: u32, wrong: &[bool]) -> Regions {
        let mut left = wrong.to_vec();
        let mut found = Regions::default();
        for start in 0..left.len() {
            let mut open = vec![start];
            let mut size = 0;
            while let Some(i) = open.pop() {
                if std::mem::take(&mut left[i]) {
                    size += 1;
                    open.extend(neighbours(n, i as u32).map(|j| j as usize));
                }
            }
            found.count += u32::from(size > 0);
            found.largest = found.largest.max(size);
        }
        found
    }

    proptest::proptest! {
        #[test]
        fn union_find_equals_flooding(
            image in (1u32..9).prop_flat_map(|n| {
                let pixels = proptest::collection::vec(proptest::bool::weighted(0.55), (6 * n * n) as usize);
                (proptest::strategy::Just(n), pixels)
            })
        ) {
            let (n, wrong) = image;
            proptest::prop_assert_eq!(regions(n, &wrong), flooded(n, &wrong));
        }
    }
}
