//! Tests of kinds and of their bytes.

use proptest::prelude::*;
use sightline_numbers::ids::TriangleId;

use super::*;

fn kind() -> impl Strategy<Value = SurfaceKind> {
    (0..SurfaceKind::ALL.len()).prop_map(|k| SurfaceKind::ALL[k])
}

proptest! {
    #[test]
    fn kinds_survive_encoding(
        parts in prop::collection::vec((1u32..50, kind(), "[a-c]{0,3}"), 1..20),
        rules in prop::collection::vec((kind(), "[*a-c]{0,5}"), 0..4),
        cut in any::<prop::sample::Index>(),
    ) {
        let triangles = parts.iter().map(|p| p.0).sum();
        let rules: Vec<KindRule> = rules.into_iter().map(|(kind, glob)| KindRule { kind, glob }).collect();
        let kinds = Kinds::from_runs(parts.iter().map(|(n, k, r)| (*n, *k, r.as_str())), rules.clone());
        let truth: Vec<SurfaceKind> =
            parts.iter().flat_map(|(n, k, _)| std::iter::repeat_n(*k, *n as usize)).collect();
        for (id, k) in truth.iter().enumerate() {
            prop_assert_eq!(kinds.kind(TriangleId(id as u32)), *k);
        }
        prop_assert_eq!(kinds.all_opaque(), truth.iter().all(|k| *k == SurfaceKind::Opaque));
        let mut bytes = Vec::new();
        write(&kinds, &mut bytes);
        if !kinds.runs.is_empty() {
            prop_assert_eq!(&read(&bytes, triangles, false), &Ok((kinds.clone(), &[][..])));
            let counted: u64 = kinds.counts().iter().map(|c| c.triangles).sum();
            prop_assert_eq!(counted, u64::from(triangles));
            // Truncated bytes, and bytes for another scene, are rejected.
            prop_assert!(read(&bytes[..cut.index(bytes.len())], triangles, false).is_err());
            prop_assert!(read(&bytes, triangles + 1, false).is_err());
        }
    }
}

#[test]
fn masked_triangles_form_ranges_and_no_rule_creates_them() {
    use SurfaceKind::{Masked, Opaque};
    let kinds = |rules| {
        let runs = [
            (2, Masked, "a"),
            (3, Masked, "b"),
            (1, Opaque, "a"),
            (4, Masked, "a"),
        ];
        Kinds::from_textures(runs, rules)
    };
    assert_eq!(kinds(Vec::new()).masked(), [(0, 5), (6, 4)]);
    assert!(kinds(Vec::new()).any_masked() && kinds(Vec::new()).check("test", 10).is_ok());
    let rule = KindRule {
        kind: Masked,
        glob: "*".to_owned(),
    };
    assert!(kinds(vec![rule]).check("test", 10).is_err());
}

#[test]
fn kind_blocks_and_shows_by_definition() {
    let truth = [(true, true), (false, true), (true, false), (false, false)];
    for (kind, (blocks, shows)) in SurfaceKind::ALL.into_iter().zip(truth) {
        assert_eq!((kind.blocks(), kind.shows()), (blocks, shows), "{kind:?}");
        assert_eq!(SurfaceKind::new(blocks, shows), kind);
        assert_eq!(SurfaceKind::from_name(kind.name()), Some(kind));
    }
    // A masked triangle blocks some lines, so no code may rely on it as a blocker.
    assert!(!SurfaceKind::Masked.blocks() && SurfaceKind::Masked.shows());
    assert_eq!(SurfaceKind::from_name("masked"), Some(SurfaceKind::Masked));
    assert!(!SurfaceKind::Door.blocks() && !SurfaceKind::Door.shows());
    assert_eq!(SurfaceKind::from_name("doors"), Some(SurfaceKind::Door));
}
