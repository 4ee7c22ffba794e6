//! Tests of kinds and of their bytes.

use proptest::prelude::*;

use super::*;

fn kind() -> impl Strategy<Value = Kind> {
    (0usize..6).prop_map(|k| Kind::ALL[k])
}

proptest! {
    #[test]
    fn kinds_are_read_as_they_were_written(
        parts in prop::collection::vec((1u32..50, kind(), "[a-c]{0,3}"), 1..20),
        rules in prop::collection::vec((kind(), "[*a-c]{0,5}"), 0..4),
        cut in any::<prop::sample::Index>(),
    ) {
        let triangles = parts.iter().map(|p| p.0).sum();
        let rules: Vec<Rule> = rules.into_iter().map(|(kind, glob)| Rule { kind, glob }).collect();
        let kinds = Kinds::from_runs(parts.iter().map(|(n, k, r)| (*n, *k, r.as_str())), rules.clone());
        let truth: Vec<Kind> =
            parts.iter().flat_map(|(n, k, _)| std::iter::repeat_n(*k, *n as usize)).collect();
        for (id, k) in truth.iter().enumerate() {
            prop_assert_eq!(kinds.kind(id as u32), *k);
        }
        prop_assert_eq!(kinds.all_opaque(), truth.iter().all(|k| *k == Kind::Opaque));
        let mut bytes = Vec::new();
        write(&kinds, &mut bytes);
        if !kinds.runs.is_empty() {
            prop_assert_eq!(&read(&bytes, triangles, false), &Ok((kinds.clone(), &[][..])));
            let counted: u64 = kinds.counts().iter().map(|c| c.triangles).sum();
            prop_assert_eq!(counted, u64::from(triangles));
            // Cut anywhere, or for another scene, the bytes are refused.
            prop_assert!(read(&bytes[..cut.index(bytes.len())], triangles, false).is_err());
            prop_assert!(read(&bytes, triangles + 1, false).is_err());
        }
    }
}

#[test]
fn masked_triangles_are_ranges_and_no_rule_makes_them() {
    use Kind::{Masked, Opaque};
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
    let rule = Rule {
        kind: Masked,
        glob: "*".to_owned(),
    };
    assert!(kinds(vec![rule]).check("test", 10).is_err());
}

#[test]
fn a_kind_blocks_and_shows_by_its_definition() {
    let truth = [(true, true), (false, true), (true, false), (false, false)];
    for (kind, (blocks, shows)) in Kind::ALL.into_iter().zip(truth) {
        assert_eq!((kind.blocks(), kind.shows()), (blocks, shows), "{kind:?}");
        assert_eq!(Kind::of(blocks, shows), kind);
        assert_eq!(Kind::from_name(kind.name()), Some(kind));
    }
    // A masked triangle blocks some lines, so no code may rely on it as a blocker.
    assert!(!Kind::Masked.blocks() && Kind::Masked.shows());
    assert_eq!(Kind::from_name("masked"), Some(Kind::Masked));
    assert!(!Kind::Door.blocks() && !Kind::Door.shows());
    assert_eq!(Kind::from_name("doors"), Some(Kind::Door));
}
