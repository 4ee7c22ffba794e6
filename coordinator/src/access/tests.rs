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
    let longest = "x".repeat(MAX_USER_BYTES);
    assert!(file.add(&longest, &[Scope::Read], 1, [0; 36]).is_ok());
    assert!(file.add("ada", &[], 1, [0; 36]).is_err());
    for bad in ["", "{}", "{\"tokens\":[{}]}", "[]"] {
        std::fs::write(&path, bad).unwrap();
        assert!(
            matches!(TokenFile::read(&path), Err(TokenError::Form { .. })),
            "{bad}"
        );
    }
}

/// Returns a folder with the token file of one user, its path and contents, the user's token, and the access
/// control.
fn one_user() -> (tempfile::TempDir, PathBuf, TokenFile, String, Access) {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("tokens.json");
    let mut file = TokenFile::default();
    let ada = token(&mut file, "ada", &[Scope::Read], 1);
    file.write(&path).unwrap();
    let access = Access::new(Some(path.clone()), false).unwrap();
    (directory, path, file, ada, access)
}

#[test]
fn revoked_token_is_rejected_after_file_change() {
    let (_directory, path, mut file, ada, access) = one_user();
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

#[test]
fn certificates_admit_workers_without_tokens() {
    let open = Access::new(None, false).unwrap();
    let certified = Access::new(None, true).unwrap();
    let worker = Need::Scope(Scope::Worker);
    // Without an authority, a certificate identifies no caller, and all calls are permitted.
    let nobody = open.identify(None, Some(b"certificate")).unwrap();
    assert!(matches!(nobody, Caller::Nobody));
    for scope in Scope::ALL {
        assert!(open.permit(&nobody, Need::Scope(scope)).is_ok(), "{scope}");
    }
    // With an authority, only calls of workers need a certificate.
    let known = certified.identify(None, Some(b"certificate")).unwrap();
    assert!(matches!(&known, Caller::User { name, scopes }
        if name.starts_with("certificate ") && scopes.named() == [Scope::Worker]));
    assert!(certified.permit(&known, worker).is_ok());
    let refusal = certified.permit(&Caller::Nobody, worker).unwrap_err();
    assert!(matches!(&refusal, Refusal::Unknown(text) if text.contains("--cert")));
    for scope in [Scope::Read, Scope::Submit, Scope::Admin] {
        assert!(
            certified
                .permit(&Caller::Nobody, Need::Scope(scope))
                .is_ok(),
            "{scope}"
        );
    }
}

#[test]
fn scopes_have_names() {
    let names = Scope::ALL.map(|scope| scope.to_string());
    assert_eq!(names, ["read", "submit", "worker", "admin"]);
    for scope in Scope::ALL {
        assert_eq!(scope.to_string().parse(), Ok(scope));
    }
    let error = "Read".parse::<Scope>().unwrap_err();
    assert_eq!(error, "a scope is read, submit, worker or admin");
}

#[test]
fn longest_token_file_is_read_and_longer_one_is_not() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("tokens.json");
    let mut text = serde_json::to_vec(&TokenFile::default()).unwrap();
    text.resize(tokens::MAX_BYTES as usize, b' ');
    std::fs::write(&path, &text).unwrap();
    assert!(TokenFile::read(&path).is_ok());
    text.push(b' ');
    std::fs::write(&path, &text).unwrap();
    assert!(matches!(
        TokenFile::read(&path).unwrap_err(),
        TokenError::Form { reason, .. } if reason.starts_with("the file has 67108865 bytes")
    ));
}

#[test]
fn session_ends_with_revocation_of_its_token() {
    let (_directory, path, mut file, ada, access) = one_user();
    let digest = TokenDigest::of_text(&ada);
    let caller = access.identify_digest(&digest).unwrap();
    assert_eq!(caller, access.identify(Some(&ada), None).unwrap());
    assert!(
        access
            .identify_digest(&TokenDigest::of_text("slt_0_0"))
            .is_err()
    );
    file.revoke(&file.tokens[0].id.clone());
    file.write(&path).unwrap();
    access.refresh();
    assert!(access.identify_digest(&digest).is_err());
}

#[test]
fn ids_and_digests_of_token_file_are_hexadecimal() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("tokens.json");
    let mut file = TokenFile::default();
    token(&mut file, "ada", &[Scope::Read], 1);
    let good = file.tokens[0].clone();
    let [short, other, upper] = ["0".repeat(63), "g".repeat(64), "A".repeat(64)];
    for (id, digest) in [
        ("0123456", &good.digest),
        ("0123456g", &good.digest),
        (good.id.as_str(), &short),
        (good.id.as_str(), &other),
        (good.id.as_str(), &upper),
    ] {
        file.tokens[0].id = id.to_owned();
        file.tokens[0].digest.clone_from(digest);
        std::fs::write(&path, serde_json::to_vec(&file).unwrap()).unwrap();
        assert!(
            matches!(TokenFile::read(&path).unwrap_err(), TokenError::Form { .. }),
            "{id} {digest}"
        );
    }
}
