//! Tests of tokens, scopes and callers.

use super::*;

fn token(file: &mut TokenFile, user: &str, scopes: &[Scope], seed: u8) -> String {
    file.add(
        user,
        scopes,
        1,
        std::array::from_fn(|i| seed.wrapping_mul(31).wrapping_add(i as u8)),
    )
    .unwrap()
}

#[test]
fn token_file_round_trips_and_contains_no_secrets() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("tokens.json");
    let mut file = TokenFile::default();
    let ada = token(&mut file, "ada", &[Scope::Submit], 1);
    let farm = token(&mut file, "farm", &[Scope::Worker], 2);
    file.write(&path).unwrap();
    let text = std::fs::read_to_string(&path).unwrap();
    for secret in [&ada, &farm] {
        assert!(!text.contains(secret.rsplit('_').next().unwrap()));
    }
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        assert_eq!(
            std::fs::metadata(&path).unwrap().permissions().mode() & 0o777,
            0o600
        );
    }
    let mut read = TokenFile::read(&path).unwrap();
    assert_eq!(read, file);
    assert_eq!(read.find(&ada).unwrap().user, "ada");
    // Wrong tokens: another id with this secret, a shortened and a lengthened secret, other letters.
    let secret = ada.rsplit('_').next().unwrap();
    let id = farm.split('_').nth(1).unwrap();
    for wrong in [
        format!("slt_{id}_{secret}"),
        ada[..ada.len() - 1].to_owned(),
        format!("{ada}0"),
        ada.to_uppercase(),
    ] {
        assert!(read.find(&wrong).is_none(), "{wrong}");
    }
    assert!(read.revoke(ada.split('_').nth(1).unwrap()) && !read.revoke("00000000"));
    assert!(read.find(&ada).is_none() && read.find(&farm).is_some());
    for bad in ["", "a\nb", "\"", &"x".repeat(MAX_USER_BYTES + 1)] {
        assert!(
            file.add(bad, &[Scope::Read], 1, [0; 36]).is_err(),
            "{bad:?}"
        );
    }
    assert!(file.add("ada", &[], 1, [0; 36]).is_err());
    for bad in ["", "{}", "{\"tokens\":[{}]}", "[]"] {
        std::fs::write(&path, bad).unwrap();
        assert!(
            matches!(TokenFile::read(&path), Err(TokenError::Form { .. })),
            "{bad}"
        );
    }
}

#[test]
fn revoked_token_is_rejected_after_file_change() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("tokens.json");
    let mut file = TokenFile::default();
    let ada = token(&mut file, "ada", &[Scope::Read], 1);
    file.write(&path).unwrap();
    let access = Access::new(Some(path.clone()), false).unwrap();
    assert_eq!(access.identify(Some(&ada), None).unwrap().owner(), "ada");
    // A file that cannot be read does not change the accepted tokens.
    std::fs::write(&path, "spoilt").unwrap();
    access.refresh();
    assert!(access.identify(Some(&ada), None).is_ok());
    file.revoke(&file.tokens[0].id.clone());
    file.write(&path).unwrap();
    access.refresh();
    assert!(access.identify(Some(&ada), None).is_err());
}

#[test]
fn scopes_permit_their_calls_and_no_others() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("tokens.json");
    let mut file = TokenFile::default();
    let texts: Vec<String> = Scope::ALL
        .iter()
        .enumerate()
        .map(|(i, s)| token(&mut file, "x", &[*s], i as u8))
        .collect();
    file.write(&path).unwrap();
    let access = Access::new(Some(path), true).unwrap();
    let calls = [
        ("/sightline.v1.Jobs/List", [true, true, false, true]),
        ("/sightline.v1.Jobs/Submit", [false, true, false, true]),
        ("/sightline.v1.Results/Why", [true, true, false, true]),
        ("/sightline.v1.Workers/Work", [false, false, true, true]),
        (
            "/sightline.v1.Farm/ListWorkers",
            [false, false, false, true],
        ),
        (
            "/sightline.v1.Jobs/NotYetKnown",
            [false, false, false, true],
        ),
        ("/nonsense", [false, false, false, true]),
        ("/grpc.health.v1.Health/Check", [true; 4]),
    ];
    for (path, may) in calls {
        for (text, may) in texts.iter().zip(may) {
            let caller = access.identify(Some(text), None).unwrap();
            assert_eq!(
                access.permit(&caller, needed(path)).is_ok(),
                may,
                "{path}, {caller:?}"
            );
        }
        let nobody = access.identify(None, None).unwrap();
        assert_eq!(
            access.permit(&nobody, needed(path)).is_ok(),
            needed(path) == Need::Nothing,
            "{path}"
        );
        // A certificate identifies a worker and does not grant other scopes.
        let certified = access.identify(None, Some(b"certificate")).unwrap();
        let may = path.contains("v1.Workers") || needed(path) == Need::Nothing;
        assert_eq!(
            access.permit(&certified, needed(path)).is_ok(),
            may,
            "{path}"
        );
    }
}

#[test]
fn only_workers_authenticate_without_tokens() {
    let open = Access::new(None, false).unwrap();
    let certified = Access::new(None, true).unwrap();
    let nobody = Caller::Nobody;
    for path in ["/sightline.v1.Jobs/Submit", "/sightline.v1.Workers/Work"] {
        assert_eq!(open.permit(&nobody, needed(path)), Ok(()));
    }
    assert_eq!(
        certified.permit(&nobody, needed("/sightline.v1.Jobs/Submit")),
        Ok(())
    );
    let refused = certified.permit(&nobody, needed("/sightline.v1.Workers/Work"));
    assert!(matches!(refused, Err(Refusal::Unknown(_))));
}

#[test]
fn owners_see_their_data_and_admins_see_all() {
    let user = |name: &str, scope| Caller::User {
        name: name.to_owned(),
        scopes: Scopes::new(&[scope]),
    };
    let (ada, admin) = (user("ada", Scope::Submit), user("root", Scope::Admin));
    assert!(ada.sees("ada") && !ada.sees("bob") && !ada.sees(""));
    assert!(admin.sees("ada") && admin.sees(""));
    assert!(Caller::Nobody.sees("") && Caller::Nobody.sees("ada"));
}
