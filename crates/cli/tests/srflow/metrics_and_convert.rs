//! `srflow metrics` and `srflow convert`.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;

use serde_json::Value;
use srflow_core::{FlowField, Image, Mask, flow_colors, score};
use srflow_files::{read_flow, read_image, write_flow, write_image_png, write_mask_png, write_npy};

use crate::{fails, json, refuses, succeeds};

fn srflow(folder: &Path, arguments: &[&str]) -> Output {
    crate::srflow().current_dir(folder).args(arguments).output().unwrap()
}

fn code(output: &Output) -> i32 {
    output.status.code().expect("the program ended by itself")
}

fn wavy() -> FlowField {
    let mut flow = FlowField::from_fn(9, 5, |x, y| [x as f32 * 0.5 - 2.0, y as f32 * 1.25]);
    flow.set(4, 4, [f32::NAN; 2]);
    flow
}

#[test]
fn metrics_prints_json_with_the_documented_keys() {
    let folder = tempfile::tempdir().unwrap();
    let truth = wavy();
    let prediction = FlowField::from_fn(9, 5, |x, y| [x as f32 * 0.5 - 2.0 + y as f32, y as f32 * 1.25]);
    let mask = Mask::from_fn(9, 5, |x, _| x > 2);
    write_flow(&folder.path().join("p.flo"), &prediction).unwrap();
    write_flow(&folder.path().join("t.png"), &truth).unwrap();
    write_mask_png(&folder.path().join("m.png"), &mask).unwrap();

    let plain = srflow(folder.path(), &["metrics", "p.flo", "t.png", "--json"]);
    let masked = srflow(folder.path(), &["metrics", "p.flo", "t.png", "--mask", "m.png", "--json"]);
    for (output, mask) in [(plain, None), (masked, Some(&mask))] {
        let json = json(&output);
        let scores = score(&prediction, &truth, mask).unwrap().unwrap();
        assert_eq!(json, serde_json::to_value(scores).unwrap());
        let keys: Vec<&String> = json.as_object().unwrap().keys().collect();
        assert_eq!(keys.len(), 7);
        assert_eq!(json["epe"], scores.epe);
    }
}

#[test]
fn metrics_prints_a_table_for_people() {
    let folder = tempfile::tempdir().unwrap();
    write_flow(&folder.path().join("a.flo"), &wavy()).unwrap();
    let text = succeeds(&srflow(folder.path(), &["metrics", "a.flo", "a.flo"]));
    assert!(text.contains("EPE        0.0000 px") && text.contains("over 44 pixels"), "{text}");
    // A prediction may be unknown only where the truth is.
    write_flow(&folder.path().join("known.flo"), &FlowField::new(9, 5)).unwrap();
    let expected = "scoring a.flo against known.flo: the prediction at pixel (4, 4) is (NaN, NaN)";
    refuses(&srflow(folder.path(), &["metrics", "a.flo", "known.flo"]), 1, &[expected]);
}

/// A constant flow only varies at the outline of a masked head, where MIGAR and IGVAR set it to zero.
#[test]
fn metrics_prints_the_regularizers_of_one_flow() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    write_flow(&path("constant.flo"), &FlowField::filled(9, 7, [1.5, -2.0])).unwrap();
    write_flow(&path("step.flo"), &FlowField::from_fn(9, 7, |x, _| [if x < 4 { 0.0 } else { 1.0 }, 0.0]))
        .unwrap();
    write_image_png(&path("grey.png"), &Image::filled(9, 7, [90; 3])).unwrap();
    write_mask_png(&path("head.png"), &Mask::from_fn(9, 7, |x, y| x > 1 && y > 1)).unwrap();

    let values = |flow: &str, more: &[&str]| -> Vec<Value> {
        let arguments =
            [&["metrics", flow, "--image", "grey.png", "--regularizers", "--json"], more].concat();
        let json = json(&srflow(folder.path(), &arguments));
        assert!(json.get("epe").is_none(), "no truth, no score: {json}");
        json["regularizers"].as_array().unwrap().clone()
    };
    let of = |found: &[Value]| -> Vec<f64> {
        found.iter().map(|value| value["value"].as_f64().unwrap()).collect()
    };
    let constant = values("constant.flo", &[]);
    let names: Vec<&str> = constant.iter().map(|value| value["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["tvr", "fdr", "migar", "igvar"]);
    assert_eq!(of(&constant), [0.0; 4]);
    // A grey frame has no gradient: every weight is 1 for any base.
    assert_eq!(constant[2]["weights"]["pixels"], 63);
    assert_eq!(constant[2]["weights"]["mean_weight"], 1.0);
    assert_eq!(constant[3]["weights"]["log_base"], 1.0);

    // A step of 1 px along 7 rows: both neighbouring Sobel columns give 4 of 8, the difference gives 1.
    let step = of(&values("step.flo", &[]));
    let expected = [0.05 * 7.0 / 63.0, 0.05 * 7.0 / 63.0, 8.0 * 7.0 / 63.0, 8.0 * 7.0 / 63.0];
    for (found, expected) in step.iter().zip(expected) {
        assert!((found - expected).abs() < 1e-6, "{step:?}");
    }
    let masked = of(&values("constant.flo", &["--mask", "head.png"]));
    assert!(masked[..2] == [0.0; 2] && masked[2] > 0.0 && masked[2] == masked[3], "{masked:?}");
    let literal = of(&values("constant.flo", &["--mask", "head.png", "--m-total", "literal"]));
    assert!(literal[2] != masked[2], "{literal:?}");

    let both = ["metrics", "step.flo", "step.flo", "--image", "grey.png", "--regularizers"];
    let text = succeeds(&srflow(folder.path(), &both));
    assert!(text.contains("EPE        0.0000 px") && text.contains("\nTVR     5.5556e-3\n"), "{text}");
    assert!(text.contains("IGVAR   8.8889e-1   base e^1.000, mean weight 1.000e0 over 63 pixels"), "{text}");
}

#[test]
fn metrics_says_what_the_regularizers_need() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    write_flow(&path("a.flo"), &wavy()).unwrap();
    write_flow(&path("b.flo"), &FlowField::new(9, 5)).unwrap();
    write_image_png(&path("small.png"), &Image::new(3, 2)).unwrap();
    write_image_png(&path("frame.png"), &Image::new(9, 5)).unwrap();
    let run = |flow: &str, image: &str| {
        srflow(folder.path(), &["metrics", flow, "--image", image, "--regularizers", "--json"])
    };
    assert_eq!(
        fails(&run("b.flo", "small.png"), 1),
        "error: regularizers of b.flo over small.png: the flow is 9x5 and the first frame 3x2 (WIDTHxHEIGHT): they must \
         have the same size\n"
    );
    refuses(&run("a.flo", "frame.png"), 1, &["the flow at pixel (4, 4) is (NaN, NaN)"]);
    assert_eq!(code(&srflow(folder.path(), &["metrics", "a.flo"])), 2, "neither a truth nor --regularizers");
    assert_eq!(code(&srflow(folder.path(), &["metrics", "a.flo", "--regularizers"])), 2, "no image");
}

#[test]
fn metrics_reports_errors() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    write_flow(&path("a.flo"), &wavy()).unwrap();
    write_flow(&path("small.flo"), &FlowField::new(2, 2)).unwrap();
    write_mask_png(&path("nothing.png"), &Mask::new(9, 5)).unwrap();
    fs::write(path("cut.flo"), &fs::read(path("a.flo")).unwrap()[..50]).unwrap();

    refuses(
        &srflow(folder.path(), &["metrics", "cut.flo", "a.flo"]),
        1,
        &["cut.flo: file size: expected 372 bytes"],
    );
    refuses(
        &srflow(folder.path(), &["metrics", "small.flo", "a.flo"]),
        1,
        &["the prediction is 2x2 and the truth 9x5"],
    );
    refuses(&srflow(folder.path(), &["metrics", "a.flo", "gone.flo"]), 1, &["gone.flo: opening"]);
    refuses(
        &srflow(folder.path(), &["metrics", "a.flo", "a.flo", "--mask", "nothing.png", "--json"]),
        1,
        &["nothing to score: the truth has no known pixel inside the mask"],
    );
    assert_eq!(code(&srflow(folder.path(), &["metrics", "a.flo"])), 2);
}

#[test]
fn convert_goes_round_every_format_without_loss() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    write_flow(&path("start.flo"), &wavy()).unwrap();
    let round = ["start.flo", "a.pfm", "b.png", "c.npy", "d.flo5", "e.npz", "f.png128", "end.flo"];
    for step in round.windows(2) {
        succeeds(&srflow(folder.path(), &["convert", step[0], step[1]]));
    }
    assert_eq!(fs::read(path("start.flo")).unwrap(), fs::read(path("end.flo")).unwrap());
}

#[test]
fn convert_draws_the_colour_wheel() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    write_flow(&path("a.flo"), &wavy()).unwrap();
    succeeds(&srflow(folder.path(), &["convert", "a.flo", "a.png", "--viz"]));
    assert_eq!(read_image(&path("a.png")).unwrap(), flow_colors(&wavy(), None));
    succeeds(&srflow(folder.path(), &["convert", "a.flo", "b.png", "--viz", "--max", "2.5"]));
    assert_eq!(read_image(&path("b.png")).unwrap(), flow_colors(&wavy(), Some(2.5)));
    assert!(read_flow(&path("b.png")).is_err(), "a picture of a flow is no flow");
}

/// As PyTorch's tensors are, which is said and not guessed: an array of (2, H, 2) could be either.
#[test]
fn channels_come_first_on_request() {
    let folder = tempfile::tempdir().unwrap();
    let values = [0.5, 1.0, -0.5, 2.0, 4.0, 8.0];
    write_npy(&folder.path().join("a.npy"), &[2, 1, 3], &values).unwrap();
    let convert = |more: &[&str]| srflow(folder.path(), &[&["convert", "a.npy", "a.flo"], more].concat());
    refuses(&convert(&[]), 1, &["a.npy: shape: expected (H, W, 2)", "channels first"]);
    succeeds(&convert(&["--channels-first"]));
    let flow = read_flow(&folder.path().join("a.flo")).unwrap();
    assert_eq!(flow.pixels(), [[0.5, 2.0], [1.0, 4.0], [-0.5, 8.0]]);
    refuses(&srflow(folder.path(), &["convert", "a.ply", "b.ply", "--channels-first"]), 2, &["Gaussians"]);
}

#[test]
fn convert_overwrites_only_with_force() {
    let folder = tempfile::tempdir().unwrap();
    write_flow(&folder.path().join("a.flo"), &wavy()).unwrap();
    fs::write(folder.path().join("b.npy"), "dear").unwrap();
    refuses(&srflow(folder.path(), &["convert", "a.flo", "b.npy"]), 1, &["b.npy", "--force"]);
    assert_eq!(fs::read(folder.path().join("b.npy")).unwrap(), b"dear");
    let json = json(&srflow(folder.path(), &["convert", "a.flo", "b.npy", "--force", "--json"]));
    assert_eq!((&json["width"], &json["height"], &json["known_pixels"]), (&9.into(), &5.into(), &44.into()));
    let names: Vec<PathBuf> =
        fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert_eq!(names.len(), 2, "nothing is left beside the files: {names:?}");
}

#[test]
fn convert_reports_errors() {
    let folder = tempfile::tempdir().unwrap();
    let fast = FlowField::filled(4, 3, [600.0, 0.0]);
    write_flow(&folder.path().join("fast.flo"), &fast).unwrap();
    refuses(
        &srflow(folder.path(), &["convert", "fast.flo", "fast.png"]),
        1,
        &["fast.png: pixel (0, 0): expected components from -512"],
    );
    refuses(
        &srflow(folder.path(), &["convert", "fast.flo", "fast.xyz"]),
        2,
        &["fast.xyz: expected a name ending in one of .flo, .png"],
    );
    refuses(
        &srflow(folder.path(), &["convert", "fast.flo", "fast.flo5", "--viz"]),
        2,
        &["expected a name ending in .png"],
    );
    refuses(
        &srflow(folder.path(), &["convert", "fast.flo", "no/such/folder.npy"]),
        1,
        &["no/such/folder.npy: creating"],
    );
    for wrong in ["0", "-1", "nan", "inf", "many"] {
        let max = format!("--max={wrong}");
        assert_eq!(code(&srflow(folder.path(), &["convert", "fast.flo", "x.png", "--viz", &max])), 2);
    }
    let without_viz = srflow(folder.path(), &["convert", "fast.flo", "x.png", "--max", "3"]);
    assert_eq!(code(&without_viz), 2);
}

#[cfg(target_os = "linux")]
#[test]
fn an_output_that_cannot_be_printed_is_an_error_and_no_panic() {
    let folder = tempfile::tempdir().unwrap();
    write_flow(&folder.path().join("a.flo"), &wavy()).unwrap();
    let printing_to = |stdout: std::process::Stdio| {
        let mut command = crate::srflow();
        let command = command.current_dir(folder.path()).args(["metrics", "a.flo", "a.flo"]);
        command.stdout(stdout).output().unwrap()
    };
    let full = fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
    refuses(&printing_to(full.into()), 1, &["printing the result: No space left"]);

    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    let closed = printing_to(writer.into());
    assert_eq!(code(&closed), 1);
    assert!(closed.stderr.is_empty(), "{closed:?}");
}
