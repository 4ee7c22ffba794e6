//! Alpha textures of glTF files: the sources of masks, their positions on triangles, and rejected textures.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

mod support;

use base64::Engine as _;
use serde_json::{Value, json};
use sightline_scene::kinds::{KindRule, SurfaceKind};
use sightline_scene::load::{LoadOptions, LoadedScene, load_bytes_with, load_with};
use sightline_scene::{Scene, SceneError, TriangleId};
use support::{Gltf, SQUARE, card, png};

fn with_alpha() -> LoadOptions {
    LoadOptions {
        alpha_textures: true,
        ..LoadOptions::default()
    }
}

fn load(g: &Gltf) -> LoadedScene {
    load_bytes_with("test.glb", &g.glb(), None, &with_alpha()).unwrap()
}

fn refusal(g: &Gltf) -> String {
    let error = load_bytes_with("test.glb", &g.glb(), None, &with_alpha()).unwrap_err();
    assert!(matches!(error, SceneError::Bad { .. }));
    error.to_string()
}

fn kinds(scene: &Scene) -> Vec<SurfaceKind> {
    (0..scene.len())
        .map(|t| scene.kinds().kind(TriangleId(t)))
        .collect()
}

/// Draws the square in 4 × 2 parts, from above and from the left as in an image: x for a blocking part.
fn drawn(scene: &Scene) -> [String; 2] {
    [0.75f32, 0.25].map(|y| {
        let at = |i: u8| {
            let x = 0.125 + f32::from(i) * 0.25;
            // The square's first triangle is below its diagonal.
            let id = u32::from(y > x);
            let hit = |from: f32, to: f32| {
                scene.mask_blocks(TriangleId(id), [x, y, from], [0.0, 0.0, to])
            };
            assert_eq!(hit(1.0, -1.0), hit(-2.0, 0.5), "the same from both sides");
            if hit(1.0, -1.0) { 'x' } else { '.' }
        };
        (0..4).map(at).collect()
    })
}

#[test]
fn card_blocks_at_blocking_texels() {
    let g = card(&[0, 1, 6], |_| {});
    let loaded = load(&g);
    assert_eq!(kinds(&loaded.scene), [SurfaceKind::Masked; 2]);
    assert_eq!(drawn(&loaded.scene), ["..xx", "xx.x"]);
    assert!(loaded.warnings.is_empty(), "{:?}", loaded.warnings);
    let [count] = &loaded.scene.kinds().counts()[..] else {
        panic!("one kind")
    };
    assert_eq!(
        (count.kind, count.reason.as_str(), count.triangles),
        (SurfaceKind::Masked, "alphaMode MASK", 2)
    );
    // The masks are part of the canonical bytes and of the digest.
    let blob = loaded.scene.to_blob();
    assert!(blob.starts_with(b"SLSCENE5"));
    let again = Scene::from_blob("blob", &blob).unwrap();
    assert_eq!(
        (again.masks(), again.digest()),
        (loaded.scene.masks(), loaded.scene.digest())
    );
    assert_eq!(again.to_blob(), blob);
    assert_ne!(
        load(&card(&[0, 1, 7], |_| {})).scene.digest(),
        loaded.scene.digest()
    );
    for end in (0..blob.len()).chain([blob.len() + 1]) {
        let mut changed = blob.clone();
        changed.resize(end, 0);
        assert!(Scene::from_blob("blob", &changed).is_err(), "{end}");
    }
    // Without the option textures are not read, and the bytes are unchanged.
    let without = load_bytes_with("test.glb", &g.glb(), None, &LoadOptions::default())
        .unwrap()
        .scene;
    assert_eq!(kinds(&without), [SurfaceKind::SeeThrough; 2]);
    assert!(without.to_blob().starts_with(b"SLSCENE5"));
    let broken = card(&[0], |g| g.json["textures"] = json!([{"source": 7}]));
    assert_eq!(kinds(&broken.load().unwrap()), [SurfaceKind::SeeThrough; 2]);
}

#[test]
fn uniform_masks_are_closed_or_open() {
    let closed = load(&card(&[], |_| {})).scene;
    assert_eq!(kinds(&closed), [SurfaceKind::Opaque; 2]);
    // The scene stores that textures were read, so that a result specifies how to read its scene.
    assert!(closed.kinds().alpha_textures() && closed.kinds().all_opaque());
    assert_eq!(
        closed.kinds().counts()[0].reason,
        "alphaMode MASK, opaque everywhere"
    );
    let again = Scene::from_blob("blob", &closed.to_blob()).unwrap();
    assert_eq!(
        (again.kinds(), again.to_blob()),
        (closed.kinds(), closed.to_blob())
    );
    assert_eq!(
        drawn(&load(&card(&[0, 1, 2, 3, 4, 5, 6, 7], |_| {})).scene),
        ["....", "...."]
    );
    // Without a texture the factor decides.
    let factor = |alpha: f64| {
        let pbr = json!({"baseColorFactor": [1, 1, 1, alpha]});
        load(&card(&[], |g| {
            g.json["materials"][0]["pbrMetallicRoughness"] = pbr
        }))
        .scene
    };
    assert_eq!(kinds(&factor(0.5)), [SurfaceKind::Opaque; 2]);
    assert_eq!(
        (kinds(&factor(0.4)), drawn(&factor(0.4))[0].as_str()),
        (vec![SurfaceKind::Masked; 2], "....")
    );
    // Factor and cutoff also apply to textures.
    let both = |alpha: f64, cutoff: f64| {
        kinds(
            &load(&card(&[0], |g| {
                g.json["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"] =
                    json!([0, 0, 0, alpha]);
                g.json["materials"][0]["alphaCutoff"] = json!(cutoff);
            }))
            .scene,
        )
    };
    assert_eq!(
        both(0.6, 0.0),
        [SurfaceKind::Opaque; 2],
        "every alpha reaches a cutoff of 0"
    );
    assert_eq!(
        (both(0.6, 0.6), both(0.6, 0.7)),
        (vec![SurfaceKind::Masked; 2], vec![SurfaceKind::Masked; 2])
    );
}

#[test]
fn textures_are_placed_as_in_file() {
    let placed = |transform: Value, sampler: Value| {
        drawn(
            &load(&card(&[0, 1, 6], |g| {
                let texture =
                    &mut g.json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"];
                texture["extensions"] = json!({"KHR_texture_transform": transform});
                g.json["textures"][0]["sampler"] = json!(0);
                g.json["samplers"] = json!([sampler]);
            }))
            .scene,
        )
    };
    assert_eq!(placed(json!({}), json!({})), ["..xx", "xx.x"]);
    assert_eq!(
        placed(json!({"offset": [0.25, 0]}), json!({})),
        [".xx.", "x.xx"]
    );
    assert_eq!(
        placed(json!({"offset": [0.25, 0]}), json!({"wrapS": 33071})),
        [".xxx", "x.xx"]
    );
    assert_eq!(
        placed(json!({"offset": [-0.25, 0]}), json!({"wrapS": 33648})),
        ["...x", "xxx."]
    );
    assert_eq!(
        placed(json!({"offset": [0, 0.5]}), json!({})),
        ["xx.x", "..xx"]
    );
    assert_eq!(
        placed(json!({"offset": [0, 0.5]}), json!({"wrapT": 33071})),
        ["xx.x", "xx.x"]
    );
    // A texture that is mirrored from left to right and scaled by two.
    assert_eq!(
        placed(json!({"offset": [1, 0], "scale": [-1, 1]}), json!({})),
        ["xx..", "x.xx"]
    );
    // A half turn about the origin, then a move back into the texture. With wrapping, the offset does not
    // matter.
    let half = json!({"rotation": std::f64::consts::PI, "offset": [1, 1]});
    assert_eq!(placed(half, json!({})), ["x.xx", "xx.."]);
    // A counter-clockwise quarter turn of the coordinates maps (u, v) to (v, 1 - u), as in the extension's
    // example. The rows of the card are columns 1 and 3 of the texture, from below.
    let quarter = json!({"rotation": std::f64::consts::FRAC_PI_2, "offset": [0.125, 1]});
    assert_eq!(placed(quarter, json!({})), ["xx..", "xxxx"]);
    // Another set of coordinates, and the same set by the extension, which has precedence.
    let other = |change: &dyn Fn(&mut Value)| {
        drawn(
            &load(&card(&[0, 1, 6], |g| {
                let uv = g.pairs(&[[1., 1.], [0., 1.], [0., 0.], [1., 0.]]);
                g.json["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_1"] = json!(uv);
                change(&mut g.json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]);
            }))
            .scene,
        )
    };
    assert_eq!(other(&|t| t["texCoord"] = json!(1)), ["xx..", "x.xx"]);
    let by_extension = json!({"KHR_texture_transform": {"texCoord": 1}});
    assert_eq!(
        other(&|t| t["extensions"] = by_extension.clone()),
        ["xx..", "x.xx"]
    );
}

#[test]
fn images_come_from_glb_data_uri_or_separate_file() {
    let inside = load(&card(&[0, 1, 6], |_| {})).scene.digest();
    let image = png([4, 2], &[0, 0, 255, 255, 255, 255, 0, 255]);
    let data = format!(
        "data:image/png;base64,{}",
        base64::engine::general_purpose::STANDARD.encode(&image)
    );
    let scene = load(&card(&[], |g| g.json["images"] = json!([{"uri": data}]))).scene;
    assert_eq!(scene.digest(), inside);
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("card.glb");
    std::fs::write(
        &path,
        card(&[], |g| {
            g.json["images"] = json!([{"uri": "sub/a%20b.png"}])
        })
        .glb(),
    )
    .unwrap();
    let missing = load_with(&path, &with_alpha()).unwrap_err().to_string();
    for part in [
        "material 0 (fence), texture 0, image 0 (sub/a%20b.png)",
        "a b.png",
        "omit --alpha-textures",
    ] {
        assert!(missing.contains(part), "{missing:?} does not say {part:?}");
    }
    std::fs::create_dir(dir.path().join("sub")).unwrap();
    std::fs::write(dir.path().join("sub/a b.png"), &image).unwrap();
    assert_eq!(
        load_with(&path, &with_alpha()).unwrap().scene.digest(),
        inside
    );
    // If a texture also has an image in another format, the PNG is used.
    let with_basis = |source: Value| {
        card(&[0, 1, 6], |g| {
            g.json["textures"][0] = source;
            g.json["textures"][0]["extensions"] = json!({"KHR_texture_basisu": {"source": 0}});
        })
    };
    assert_eq!(
        load(&with_basis(json!({"source": 0}))).scene.digest(),
        inside
    );
    assert!(
        refusal(&with_basis(json!({})))
            .contains("texture 0: the texture has only an image for KHR_texture_basisu")
    );
}

#[test]
fn unsupported_masks_are_see_through_with_warning() {
    let colors = |g: &mut Gltf, alpha: u8| {
        let c = g.accessor(&[255, 255, 255, alpha].repeat(4), 5121, "VEC4", 4);
        g.json["accessors"][c]["normalized"] = json!(true);
        g.json["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = json!(c);
    };
    assert_eq!(
        kinds(&load(&card(&[0], |g| colors(g, 255))).scene),
        [SurfaceKind::Masked; 2]
    );
    let faded = load(&card(&[0], |g| colors(g, 254)));
    assert_eq!(kinds(&faded.scene), [SurfaceKind::SeeThrough; 2]);
    assert!(
        faded.warnings[0]
            .contains("mesh 0, primitive 0: the vertex colours (COLOR_0) have alpha below 1")
    );
    let bare = load(&card(&[0], |g| {
        g.json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]["texCoord"] = json!(9);
    }));
    assert_eq!(kinds(&bare.scene), [SurfaceKind::SeeThrough; 2]);
    assert!(
        bare.warnings[0].contains("no texture coordinates TEXCOORD_9"),
        "{:?}",
        bare.warnings
    );
    // The option has no effect in a scene without masks.
    let plain = load(&support::square());
    assert!(
        plain.warnings[0].contains("--alpha-textures has no effect"),
        "{:?}",
        plain.warnings
    );
}

#[test]
fn flags_motion_and_extras_have_precedence_over_mask() {
    // A texture that cannot be read is not needed in these cases.
    let broken = |change: &dyn Fn(&mut Value)| {
        card(&[0], |g| {
            g.json["textures"] = json!([]);
            change(&mut g.json);
        })
    };
    let one = |g: &Gltf, rules: Vec<KindRule>| {
        let options = LoadOptions {
            rules,
            ..with_alpha()
        };
        load_bytes_with("test.glb", &g.glb(), None, &options)
            .unwrap()
            .scene
            .kinds()
            .kind(TriangleId(0))
    };
    let none = || Vec::new();
    assert_eq!(
        one(
            &broken(&|_| {}),
            vec![KindRule::new(SurfaceKind::Opaque, "fence").unwrap()]
        ),
        SurfaceKind::Opaque
    );
    assert_eq!(
        one(&broken(&|j| j["nodes"][0]["skin"] = json!(0)), none()),
        SurfaceKind::Moving
    );
    let extras =
        |fields: Value| move |j: &mut Value| j["nodes"][0]["extras"] = json!({"sightline": fields});
    assert_eq!(
        one(&broken(&extras(json!({"blocks": true}))), none()),
        SurfaceKind::Opaque
    );
    assert_eq!(
        one(&broken(&extras(json!({"blocks": false}))), none()),
        SurfaceKind::SeeThrough
    );
    assert_eq!(
        one(&broken(&extras(json!({"shows": false}))), none()),
        SurfaceKind::Moving
    );
    let shows = card(&[0], |g| extras(json!({"shows": true}))(&mut g.json));
    assert_eq!(one(&shows, none()), SurfaceKind::Masked);
}

#[test]
fn strips_fans_and_instances_have_coordinates() {
    // The square as a strip and as a fan, in the order of their corners, with one mask.
    let as_mode = |mode: u32, order: [usize; 4]| {
        drawn(
            &load(&card(&[0, 1, 6], |g| {
                let p = g.positions(&order.map(|c| SQUARE[c]));
                let corners = [[0., 1.], [1., 1.], [1., 0.], [0., 0.]];
                let uv = g.pairs(&order.map(|c| corners[c]));
                let primitive = &mut g.json["meshes"][0]["primitives"][0];
                primitive["mode"] = json!(mode);
                primitive["attributes"] = json!({"POSITION": p, "TEXCOORD_0": uv});
                primitive.as_object_mut().unwrap().remove("indices");
            }))
            .scene,
        )
    };
    assert_eq!(as_mode(6, [0, 1, 2, 3]), ["..xx", "xx.x"]);
    // The strip's first triangle contains other corners, so the diagonal is tested the other way round.
    assert_eq!(as_mode(5, [1, 2, 0, 3]), ["..xx", "xx.x"]);
    let two = card(&[0, 1, 6], |g| {
        g.json["nodes"] = json!([{"mesh": 0}, {"mesh": 0, "translation": [0, 0, 5]}]);
        g.json["scenes"][0]["nodes"] = json!([0, 1]);
    });
    let scene = load(&two).scene;
    assert_eq!(kinds(&scene), [SurfaceKind::Masked; 4]);
    assert!(!scene.mask_blocks(TriangleId(3), [0.1, 0.9, 9.0], [0.0, 0.0, -1.0]));
    assert!(scene.mask_blocks(TriangleId(2), [0.9, 0.1, 9.0], [0.0, 0.0, -1.0]));
}

#[test]
fn unusable_textures_are_rejected_with_element() {
    let material = |change: fn(&mut Value)| card(&[0], |g| change(&mut g.json["materials"][0]));
    let json = |change: fn(&mut Value)| card(&[0], |g| change(&mut g.json));
    let bad = [
        (
            json(|j| j["textures"] = json!([])),
            "texture 0: the texture does not exist, because the file has 0 textures",
        ),
        (
            json(|j| j["textures"][0]["source"] = json!(3)),
            "the texture refers to image 3, but the file has 1",
        ),
        (
            json(|j| j["textures"][0] = json!({})),
            "the texture refers to no image",
        ),
        (
            json(|j| j["textures"][0]["sampler"] = json!(3)),
            "the texture refers to sampler 3, but the file has 0",
        ),
        (
            json(|j| j["textures"] = json!("none")),
            "glTF JSON, textures",
        ),
        (
            json(|j| j["images"][0] = json!({})),
            "the image must have either a uri or a buffer view",
        ),
        (
            json(|j| j["images"][0]["bufferView"] = json!(99)),
            "the file has no buffer view with this index",
        ),
        (
            json(|j| j["images"][0] = json!({"uri": "../up.png"})),
            "not a plain path below",
        ),
        (
            json(|j| j["images"][0] = json!({"uri": "data:image/png;base64,AAAA"})),
            "neither PNG nor JPEG",
        ),
        (
            json(|j| j["images"][0] = json!({"name": "leaf", "uri": "data:,"})),
            "image 0 (leaf)",
        ),
        (
            material(|m| m["alphaCutoff"] = json!("half")),
            "material 0 (fence): the alphaCutoff is not a finite",
        ),
        (
            material(|m| m["pbrMetallicRoughness"]["baseColorTexture"] = json!({"index": -1})),
            "the texture is not an index: -1",
        ),
        (
            material(|m| m["pbrMetallicRoughness"]["baseColorFactor"] = json!([1, 1, 1])),
            "the base colour factor has no alpha",
        ),
        (
            card(&[0], |g| {
                let uv = g.pairs(&[[0.0; 2]; 2]);
                g.json["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = json!(uv);
            }),
            "vertex 2 has no texture coordinates: the accessor has 2 elements",
        ),
        (
            card(&[0], |g| {
                let uv = g.pairs(&[[f32::NAN; 2]; 4]);
                g.json["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = json!(uv);
            }),
            "the texture coordinates of vertex 0 are not finite",
        ),
        (
            card(&[0], |g| {
                let view = g.view(&png([4, 2], &[0; 8])[..60]);
                g.json["images"][0]["bufferView"] = json!(view);
            }),
            "texture 0, image 0: the PNG image cannot be decoded",
        ),
    ];
    for (file, said) in bad {
        let why = refusal(&file);
        assert!(why.contains(said), "{why:?} does not say {said:?}");
    }
}
