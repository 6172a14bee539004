//! `srflow figure`: its files, what it shows, and what it refuses.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use srflow_core::{FlowField, Size, flow_colors};
use srflow_files::{read_image, write_flow};

use crate::frames::{waves, write_pairs};
use crate::{json, refuses, succeeds};

const SIZE: Size = Size::new(96, 72);

fn figure(dir: &Path, arguments: &[&str]) -> Output {
    crate::srflow().arg("figure").args(arguments).current_dir(dir).output().expect("srflow runs")
}

/// A folder with three pairs, and two flows of the first under `theirs`.
fn pairs() -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    write_pairs(&dir.path().join("set"), 3, SIZE, 2.0);
    let flow = FlowField::from_fn(SIZE.width, SIZE.height, |x, y| [x as f32 / 40.0, y as f32 / -60.0]);
    write_flow(&dir.path().join("a.flo"), &flow).unwrap();
    write_flow(&dir.path().join("b.npy"), &FlowField::filled(SIZE.width, SIZE.height, [1.0, 0.5])).unwrap();
    dir
}

#[test]
fn a_dataset_becomes_a_figure_and_panels() {
    let dir = pairs();
    let arguments =
        ["--dataset", "folder:set", "--samples", "p2", "0", "--method", "tvl1", "Theirs:farneback"];
    let more = ["-o", "fig.pdf", "fig.svg", "--panels", "panels", "--letters"];
    let arguments = [&arguments[..], &more].concat();
    let printed = json(&figure(dir.path(), &[&arguments[..], &["--json"]].concat()));
    assert_eq!(printed["size_mm"][0], 178.0);
    assert_eq!(printed["pairs"][0]["name"], "p2");
    assert_eq!(printed["pairs"][1]["scales"]["flow"], 2.0);
    assert_eq!(printed["pairs"][1]["methods"][1]["name"], "Theirs");
    let names = ["truth", "flow-tvl1", "flow-Theirs", "frame1", "error-tvl1", "error-Theirs"];
    for (number, panel) in printed["panels"].as_array().unwrap().iter().enumerate() {
        let pair = if number < 6 { "p2" } else { "p0" };
        let name = format!("panels/{:02}-{pair}-{}.png", number + 1, names[number % 6]);
        assert_eq!(*panel, Path::new(&name).display().to_string());
        assert_eq!(read_image(&dir.path().join(name)).unwrap().size(), SIZE);
    }
    assert_eq!(fs::read_dir(dir.path().join("panels")).unwrap().count(), 12);
    assert_eq!(
        read_image(&dir.path().join("panels/04-p2-frame1.png")).unwrap(),
        read_image(&dir.path().join("set/p2_img1.png")).unwrap()
    );
    let truth = read_image(&dir.path().join("panels/01-p2-truth.png")).unwrap();
    assert_eq!(truth, flow_colors(&FlowField::filled(SIZE.width, SIZE.height, [2.0, 0.0]), Some(2.0)));
    let svg = fs::read_to_string(dir.path().join("fig.svg")).unwrap();
    assert_eq!(svg.matches("<image ").count(), 12 + 2, "the panels, the wheel and the bar");
    for text in ["Ground truth / Frame 1", ">tvl1<", ">Theirs<", ">p2<", ">p0<", "(f) EPE 0.", "radius: 2 px"]
    {
        assert!(svg.contains(text), "{text}");
    }
    let pdf = fs::read(dir.path().join("fig.pdf")).unwrap();

    refuses(&figure(dir.path(), &arguments), 1, &["fig.pdf exists; give --force"]);
    let text = succeeds(&figure(dir.path(), &[&arguments[..], &["--force"]].concat()));
    assert!(text.contains("fig.pdf: 178.0 mm x ") && text.contains("panels: 12 panels"), "{text}");
    assert!(fs::read(dir.path().join("fig.pdf")).unwrap() == pdf, "the same bytes again");
    rendered_by_poppler(&dir.path().join("fig.pdf"));
}

/// What another program makes of the PDF, if it is installed.
fn rendered_by_poppler(pdf: &Path) {
    match Command::new("pdftotext").arg(pdf).arg("-").output() {
        Ok(output) => {
            let text = String::from_utf8_lossy(&output.stdout).into_owned();
            assert!(output.status.success() && output.stderr.is_empty(), "{output:?}");
            assert!(text.contains("Theirs") && text.contains("radius: 2 px"), "{text}");
        }
        Err(_) => eprintln!("skipped: poppler: no pdftotext on the PATH"),
    }
}

#[test]
fn files_of_other_programs_become_a_figure() {
    let dir = pairs();
    let frames = ["--frames", "set/p0_img1.png", "set/p0_img2.png"];
    let flows = ["--flow", "Ours & <more>=a.flo", "b.npy", "--truth", "set/p0_flow.flo"];
    let usual = [&frames[..], &flows, &["--force"]].concat();
    let crop = ["--crop", "10,20,40x30", "--columns", "flow", "strain", "error:b", "--panels", "crop"];
    let printed = json(&figure(dir.path(), &[&usual[..], &crop, &["--json", "-o", "crop.svg"]].concat()));
    assert_eq!(printed["pairs"][0]["methods"][0]["name"], "Ours & <more>");
    let epe = printed["pairs"][0]["methods"][1]["epe"].as_f64().unwrap();
    assert!((epe - 1.25_f64.sqrt()).abs() < 1e-6, "{epe}");
    let svg = fs::read_to_string(dir.path().join("crop.svg")).unwrap();
    assert!(svg.contains("Ours &amp; &lt;more&gt;, strain") && !svg.contains("<more"));
    let flow = FlowField::from_fn(40, 30, |x, y| [(x + 10) as f32 / 40.0, (y + 20) as f32 / -60.0]);
    let scale = printed["pairs"][0]["scales"]["flow"].as_f64().unwrap();
    assert_eq!(
        read_image(&dir.path().join("crop/01-p0_img1-flow-Ours-more.png")).unwrap(),
        flow_colors(&flow, Some(scale as f32))
    );

    // Methods beside files, without truth.
    let arguments =
        [&frames[..], &["--flow", "a.flo", "--method", "tvl1", "-o", "both.svg", "--arrows", "12"]].concat();
    succeeds(&figure(dir.path(), &arguments));
    let svg = fs::read_to_string(dir.path().join("both.svg")).unwrap();
    assert!([">Frame 2<", ">a<", ">tvl1<"].iter().all(|text| svg.contains(text)) && !svg.contains("EPE"));

    let words = [
        "--titles",
        "One",
        "",
        "--captions",
        "left",
        "right",
        "--columns",
        "flow",
        "-o",
        "words.pdf",
        "words.svg",
    ];
    succeeds(&figure(dir.path(), &[&usual[..], &words].concat()));
    let svg = fs::read_to_string(dir.path().join("words.svg")).unwrap();
    assert!([">One<", ">left<", ">right<"].iter().all(|text| svg.contains(text)) && !svg.contains("EPE"));
}

#[test]
fn what_cannot_be_shown_is_refused_in_a_sentence() {
    let dir = pairs();
    write_flow(&dir.path().join("small.flo"), &FlowField::new(9, 9)).unwrap();
    srflow_files::write_image_png(&dir.path().join("wide.png"), &waves(Size::new(120, 72), 0.0)).unwrap();
    fs::write(dir.path().join("broken.flo"), b"PIEH").unwrap();
    let set = ["--dataset", "folder:set", "--method", "tvl1", "-o", "x.pdf"];
    let frames = ["--frames", "set/p0_img1.png", "set/p0_img2.png", "-o", "x.pdf"];
    for (usual, more, code, parts) in [
        (&set[..], &["--samples", "p9"][..], 2, &["--samples", "p0, p1, p2", "0 to 2", "p9"][..]),
        (&set, &["--samples", "3"], 2, &["0 to 2", "found 3"]),
        (&set, &["--columns", "flow:raft"], 2, &["--columns", "flow:raft", "tvl1"]),
        (&set, &["--columns", "frames"], 2, &["frames", "frame1, frame2, overlay"]),
        (&set, &["--columns", ""], 2, &["frame1, frame2, overlay"]),
        (&set, &["--crop", "10,10,96x10"], 2, &["--crop", "column 10", "96x72"]),
        (&set, &["--crop", "200x10"], 1, &["--crop of p0", "200x10", "96x72"]),
        (&set, &["--crop", "18446744073709551615,0,8x8"], 2, &["not within"]),
        (&set, &["--crop", "10x0"], 2, &["X,Y,WIDTHxHEIGHT"]),
        (&set, &["--width", "12"], 2, &["17.8cm"]),
        (&set, &["--width", "1mm"], 1, &["2 columns within 1.0 mm", "fewer columns"]),
        (&set, &["--width", "90000in"], 1, &["the largest page of a PDF"]),
        (&set, &["--flow-scale", "-1"], 2, &["--flow-scale", "above 0"]),
        (&set, &["--titles", "a"], 2, &["--titles: expected 2, one for each column, found 1"]),
        (&set, &["--labels", "a", "光", "b"], 1, &["光", "U+5149", "Helvetica"]),
        (&set, &["--flow", "a.flo"], 2, &["--flow", "cannot be used with"]),
        (&set, &["--frames", "a.png", "b.png"], 2, &["cannot be used with"]),
        (&[], &["-o", "x.pdf"], 2, &["--dataset"]),
        (&["--dataset", "folder:set"], &[], 2, &["--output"]),
        (&["--dataset", "folder:set"], &["-o", "x.png"], 2, &["x.png", ".pdf or .svg", "--panels"]),
        (&["--dataset", "folder:none"], &["-o", "x.pdf"], 1, &["none"]),
        (&frames, &["--columns", "truth"], 2, &["--truth"]),
        (&frames, &["--flow", "small.flo"], 1, &["small.flo", "96x72", "found 9x9"]),
        (&frames, &["--flow", "broken.flo"], 1, &["broken.flo"]),
        (&frames, &["--flow", "none.flo"], 1, &["none.flo"]),
        (&frames, &["--flow", "=a.flo"], 2, &["NAME=FLOW"]),
        (&frames, &["--flow", "a.flo", "a=b.npy"], 2, &["two methods have the name a"]),
        (&frames, &["--flow", "truth=a.flo"], 2, &["--flow truth: this name is for the true flow"]),
        (&frames, &["--method", "files:set"], 2, &["--flow NAME=FLOW"]),
        (
            &["--frames", "set/p0_img1.png", "wide.png"],
            &["-o", "x.pdf", "--method", "tvl1"],
            1,
            &["wide.png 120x72"],
        ),
    ] {
        refuses(&figure(dir.path(), &[usual, more].concat()), code, parts);
    }
    let columns = vec!["frame1"; 1000];
    let many = [&set[..], &["--max-columns", "2000", "--columns"], &columns].concat();
    refuses(&figure(dir.path(), &many), 1, &["1000 columns within 178.0 mm"]);
    // Panels alone have no page to be too large for.
    let strip = ["--crop", "1x72", "--columns", "frame1", "--panels", "strip"];
    refuses(&figure(dir.path(), &[&set[..], &strip].concat()), 1, &["the largest page of a PDF"]);
    let panels = json(&figure(dir.path(), &[&set[..2], &strip, &["--json"]].concat()));
    assert_eq!((panels["size_mm"].is_null(), panels["panels"].as_array().map(Vec::len)), (true, Some(3)));
    assert!(!dir.path().join("x.pdf").exists());
}
