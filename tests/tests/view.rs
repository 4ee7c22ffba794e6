//! Tests of `sightline view`: the page in a browser, its pictures, its answers to clicks, and its messages
//! about bad input.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use sightline_tests::{Browser, Sandbox, across, ask, house, wait_for};

/// Returns a folder with the scene and its exact result, with a cell in each room.
fn sandbox() -> Sandbox {
    let sandbox = Sandbox::new();
    // A wall at x = 2 leaves y from 1 to 2 open; the shelf is behind the wall.
    let shelf = [
        [2.2, 0.1, 0.5],
        [2.5, 0.1, 0.5],
        [2.5, 0.1, 1.0],
        [2.2, 0.1, 1.0],
    ];
    sandbox.write(
        "house.obj",
        house(&[
            ("wall", across(2.0, [0.0, 1.0], [0.0, 2.0])),
            ("shelf", shelf),
        ]),
    );
    let boxes = "--view-box 0.25,0.25,0.25,3.65,0.9,1.75 --cells 2x1x1";
    sandbox.ok(&format!(
        "bake house.obj -o house.pvs --method exact --backend cpu {boxes}"
    ));
    sandbox
}

fn text(browser: &Browser, id: &str) -> String {
    browser
        .run(&format!(
            "return document.getElementById('{id}').textContent"
        ))
        .as_str()
        .unwrap()
        .to_owned()
}

#[test]
fn page_shows_cell_and_answers_clicks_without_errors() {
    let sandbox = sandbox();
    sandbox.ok("view house.pvs house.obj --cell 0 -o house.html");
    let Some(browser) = Browser::start([1000, 700]) else {
        return;
    };
    browser.open(&format!("file://{}", sandbox.path("house.html").display()));
    // The camera looks east, at the wall and over it.
    let ready =
        "const page = await sightline; page.jump([0.5, 0.8, 1], [1, 0, 0]); return page !== null;";
    assert_eq!(browser.run(ready), true);
    let status = text(&browser, "status");
    assert!(status.contains("Cell 0 of 2"), "{status}");
    let state = |script: &str| browser.run(&format!("const page = await sightline; {script}"));
    let dump = sandbox.dump("house.pvs");
    assert_eq!(state("return page.drawn"), dump.cells[0].visible.len());
    // The shelf is behind the wall, below the opening. All triangles except its two are visible.
    assert!(dump.cells[0].visible.len() < 16);
    let shelf = "page.choose(page.pvs.objects.find((o) => o.name === 'shelf').first);";
    state(shelf);
    let why = text(&browser, "why");
    assert!(
        why.contains("“shelf” is hidden from cell 0") && why.contains("“wall”"),
        "{why}"
    );
    // A click in the middle of the window hits the wall or an object above it.
    browser.click(700, 350);
    let why = text(&browser, "why");
    assert!(
        why.contains("is visible from cell 0") && why.contains("A free segment"),
        "{why}"
    );
    assert_eq!(state("return page.answer.seen.length"), 3);
    // Hidden triangles are red only on request.
    let reds = "const gl = page.renderer.gl, w = gl.drawingBufferWidth, h = gl.drawingBufferHeight;
        const p = new Uint8Array(4 * w * h);
        page.choose(-1); page.draw(); gl.readPixels(0, 0, w, h, gl.RGBA, gl.UNSIGNED_BYTE, p); let n = 0;
        for (let i = 0; i < p.length; i += 4) {
          n += p[i] > 2 * p[i + 1] + 20 && p[i] > 2 * p[i + 2] + 20;
        }
        return n;";
    assert_eq!(state(reds), 0);
    // From above the wall, with the frozen set, the shelf would be in view.
    let over =
        "document.getElementById('freeze').click(); page.jump([1.9, 1.9, 0.75], [0.3, -1, 0]);";
    state(&format!(
        "{over} document.getElementById('hidden').click();"
    ));
    let count = state(reds).as_u64().unwrap();
    assert!(count > 100, "{count} red pixels");
    assert_eq!(
        state("document.getElementById('hidden').click(); return page.cell"),
        0
    );
    // Select another cell in the panel.
    state(
        "document.getElementById('freeze').click(); document.getElementById('cell').value = 1;
        document.getElementById('go').click();",
    );
    assert_eq!(
        state("return [page.cell, page.drawn]"),
        serde_json::json!([1, dump.cells[1].visible.len()])
    );
    state("document.getElementById('cell').value = 7; document.getElementById('go').click();");
    assert!(text(&browser, "note").contains("no cell 7"));
    assert_eq!(browser.messages(), Vec::<String>::new());
}

/// Tests the page's rays in a separate scene: 1×1 walls with a hole of 0.2, or a scene without blockers.
#[test]
fn rays_find_hole_and_end_without_blockers() {
    let sandbox = Sandbox::new();
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .unwrap();
    let folder = root.join("crates/view/page");
    let modules = ["math.mjs", "trace.mjs", "why.mjs"].map(|name| {
        let text = std::fs::read_to_string(folder.join(name)).unwrap();
        let is_word = |line: &&str| !line.starts_with("import ");
        text.lines()
            .filter(is_word)
            .map(|line| line.strip_prefix("export ").unwrap_or(line).to_owned() + "\n")
            .collect::<String>()
    });
    let page = format!(
        "<!doctype html><meta charset=utf-8><link rel=icon href=data:,><script type=module>{}
         const quad = (a, b, c, d) => [...a, ...b, ...c, ...a, ...c, ...d];
         const across = (x, [y, z], [v, w]) => quad([x, y, z], [x, v, z], [x, v, w], [x, y, w]);
         // A wall at x = 1 that leaves 0.4 to 0.6 open, and the target behind it at x = 2.
         const at = new Float32Array([across(1, [0, 0], [0.4, 1]), across(1, [0.6, 0], [1, 1]),
           across(1, [0.4, 0], [0.6, 0.4]), across(1, [0.4, 0.6], [0.6, 1]),
           across(2, [0, 0], [1, 1])].flat());
         const tracer = new Tracer(at, new Uint8Array(10).fill(1)), box = [0, 0.45, 0.45, 0.5, 0.55, 0.55];
         const from = {{ base: null, eye: [0.25, 0.5, 0.5], far: Infinity }};
         const seen = why(tracer, box, from, [8, 9]);
         const near = why(tracer, box, {{ ...from, far: 1 }}, [8, 9]);
         const none = new Tracer(at, new Uint8Array(10));
         // Rays along the border of the wall's boxes, in both directions of a coordinate that is 0.
         const level = [[1, 0, 0], [1, -0, -0]].map((d) => tracer.first_hit([0, 0.4, 0], d)[1]);
         const {{ width }} = opening(tracer, seen.seen, 3);
         globalThis.answer = {{ seen: seen.seen.length, width, near: near.rays,
           none: none.first_hit([0, 0.5, 0.5], [1, 0, 0])[0], level }};</script>",
        modules.concat()
    );
    sandbox.write("rays.html", page);
    let Some(browser) = Browser::start([300, 200]) else {
        return;
    };
    browser.open(&format!("file://{}", sandbox.path("rays.html").display()));
    let answer = browser.run("return globalThis.answer");
    assert_eq!(browser.messages(), Vec::<String>::new());
    let width = answer["width"].as_f64().unwrap();
    assert!((0.19..0.29).contains(&width), "{answer}");
    assert_eq!(
        (&answer["seen"], &answer["near"], &answer["none"]),
        (&3.into(), &0.into(), &(-1).into())
    );
    assert_eq!(answer["level"], serde_json::json!([1, 1]));
}

/// Tests that the page calls no hidden triangle of an exact result visible, and that a scene of glass opens.
#[test]
fn exact_results_are_not_contradicted() {
    let sandbox = Sandbox::new();
    sandbox.ok("generate rooms --grid 3x2 --triangles 1500 -o rooms.glb");
    sandbox.ok(
        "bake rooms.glb -o rooms.pvs --cells walls:9 --reachable-from 2,1.5,3 --method exact --backend cpu",
    );
    sandbox.ok("view rooms.pvs rooms.glb -o rooms.html");
    let Some(browser) = Browser::start([500, 400]) else {
        return;
    };
    browser.open(&format!("file://{}", sandbox.path("rooms.html").display()));
    let accused = browser.run(
        "const page = await sightline; let asked = 0, missed = 0;
         for (let cell = 0; cell < page.pvs.cells; cell++) {
           if (!page.pvs.isReached(cell)) continue;
           page.go(cell);
           for (let id = cell; id < page.pvs.triangles; id += 61) {
             if (page.state[id] & 1 || !(page.kinds[id] & 2)) continue;
             page.choose(id);
             asked++;
             missed += page.answer.missed;
           }
         }
         return [asked, missed];",
    );
    assert!(accused[0].as_u64().unwrap() > 20, "{accused}");
    assert_eq!(accused[1], 0);
    sandbox.ok("bake rooms.glb -o glass.pvs --see-through * --cells 2x1x2 --backend cpu");
    sandbox.ok("view glass.pvs rooms.glb -o glass.html");
    browser.open(&format!("file://{}", sandbox.path("glass.html").display()));
    assert_eq!(
        browser.run("const page = await sightline; return page.pvs.cells"),
        4
    );
    assert_eq!(browser.messages(), Vec::<String>::new());
}

#[test]
fn picture_is_reproducible_and_differs_between_cells() {
    let sandbox = sandbox();
    sandbox.ok("view house.pvs house.obj -o house.html");
    let Some(browser) = Browser::start([800, 600]) else {
        return;
    };
    browser.open(&format!("file://{}", sandbox.path("house.html").display()));
    let at = |x: f32| {
        browser.run(&format!(
            "const page = await sightline; page.jump([{x}, 0.8, 1], [1, -0.2, 0]);
             document.getElementById('panel').hidden = true;
             document.getElementById('panel').style.display = 'none'; page.draw();"
        ));
        browser.picture()
    };
    let (first, other, again) = (at(0.5), at(2.5), at(0.5));
    assert_eq!(first, again);
    assert_ne!(first, other);
}

#[test]
fn served_page_accepts_only_its_own_name() {
    let sandbox = sandbox();
    let view = sandbox.start("view house.pvs house.obj --no-open");
    let line = wait_for("the address of the page", || {
        Some(view.out()).filter(|out| out.contains("shows"))
    });
    let url = line.split(' ').next().unwrap().to_owned();
    let Some(browser) = Browser::start([800, 600]) else {
        return;
    };
    browser.open(&url);
    assert_eq!(
        browser.run("const page = await sightline; return page.pvs.cells"),
        2
    );
    browser.open(&url.replace("127.0.0.1", "localhost"));
    assert_eq!(
        browser.run("const page = await sightline; return page.pvs.cells"),
        2
    );
    assert_eq!(
        browser.run("return document.title"),
        "house.pvs – house.obj"
    );
    // The server decides the visibility of the clicked triangle exactly.
    let asked = |object: &str, first: &str| {
        browser.run(&format!(
            "const page = await sightline; page.jump([0.5, 0.8, 1], [1, 0, 0]);
             const of = page.pvs.objects.find((o) => o.name === '{object}'); page.choose({first});
             if (document.getElementById('ask').hidden) throw new Error('nothing to ask');
             await page.ask();
             return [document.getElementById('why').textContent, page.answer.blockers.length];"
        ))
    };
    let hidden = asked("shelf", "of.first");
    assert!(
        hidden[0]
            .as_str()
            .unwrap()
            .contains("hidden, decided exactly"),
        "{hidden}"
    );
    assert!(
        hidden[0].as_str().unwrap().contains("“wall”") && hidden[1].as_u64() > Some(0),
        "{hidden}"
    );
    let seen = asked(
        "wall",
        "[...Array(of.count).keys()].map((k) => of.first + k).find((k) => page.state[k] & 1)",
    );
    assert!(
        seen[0]
            .as_str()
            .unwrap()
            .contains("visible, decided exactly"),
        "{seen}"
    );
    assert_eq!(browser.messages(), Vec::<String>::new());
    let pages = url
        .trim_start_matches("http://")
        .trim_end_matches('/')
        .to_owned();
    let why = |headers: &str, body: &str| ask(&pages, "POST /why", headers, body).0;
    let json = "content-type: application/json\r\n";
    assert_eq!(why(json, r#"{"cell":0,"triangle":0}"#), 200);
    assert_eq!(
        why(
            &format!("{json}origin: http://example.org\r\n"),
            r#"{"cell":0,"triangle":0}"#
        ),
        403
    );
    assert_eq!(why("", r#"{"cell":0,"triangle":0}"#), 400);
    for bad in [
        "",
        "[]",
        r#"{"cell":2,"triangle":0}"#,
        r#"{"cell":0,"triangle":4000000000}"#,
    ] {
        assert_eq!(why(json, bad), 400, "{bad}");
    }
}

#[test]
fn cells_are_drawn_without_scene() {
    let sandbox = sandbox();
    sandbox.ok("view house.pvs -o cells.html");
    let Some(browser) = Browser::start([800, 600]) else {
        return;
    };
    browser.open(&format!("file://{}", sandbox.path("cells.html").display()));
    browser.run("await sightline;");
    assert!(text(&browser, "note").contains("Without the scene"));
    assert_eq!(browser.messages(), Vec::<String>::new());
}

#[test]
fn bad_input_is_reported() {
    let sandbox = sandbox();
    sandbox.ok("generate rooms --grid 2x2 --triangles 800 -o other.glb");
    sandbox
        .run("view house.pvs other.glb -o x.html")
        .code(3)
        .says("baked from another scene");
    sandbox
        .run("view house.obj -o x.html")
        .code(3)
        .says("not a .pvs file");
    sandbox
        .run("view house.pvs house.obj --cell 2 -o x.html")
        .code(2)
        .says("has 2 cells");
    sandbox.write("worst.json", "{}");
    sandbox
        .run("view house.pvs house.obj --worst worst.json -o x.html")
        .code(3)
        .says("the list \"worst\" is missing");
    sandbox
        .run("view house.pvs house.obj -o house.obj")
        .code(2)
        .says("house.obj");
    sandbox
        .run("bake house.obj -o x.pvs --view --json")
        .code(2)
        .says("--view serves a page");
    sandbox.write(
        "worst.json",
        sandbox.ok("measure house.obj house.pvs --viewpoints 4 --backend cpu"),
    );
    sandbox.ok("view house.pvs house.obj --worst worst.json -o x.html");
}
