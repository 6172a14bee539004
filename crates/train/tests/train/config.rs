//! Configurations: presets, keys and their errors.

use std::path::Path;

use srflow_data::flow::Split;
use srflow_train::config::{Config, MadeKind, MadeSpec, PRESETS, Source};
use toml::{Table, Value};

#[test]
fn every_preset_is_complete_and_valid() {
    for preset in PRESETS {
        let config = Config::read(Path::new(preset.name)).expect(preset.name);
        config.check().expect(preset.name);
        assert_eq!(Config::parse(&config.to_toml(), "again").expect("its own text"), config);
    }
}

#[test]
fn the_papers_baseline_is_the_default() {
    let preset = Config::read(Path::new("skflow")).expect("a preset");
    assert_eq!(preset, Config::default());
}

#[test]
fn parse_errors_name_the_line_and_the_key() {
    let error = Config::parse("[training]\nbatch = 4\nlr = 1\n", "my.toml").expect_err("no key lr");
    let message = error.to_string();
    for part in ["my.toml", "line 3", "`lr`", "learning_rate"] {
        assert!(message.contains(part), "{part} in {message}");
    }
    let error = Config::parse("[data]\ncrop = \"512\"\n", "my.toml").expect_err("no size");
    assert!(error.to_string().contains("line 2") && error.to_string().contains("WIDTHxHEIGHT"), "{error}");
    let error = Config::parse("[network]\narchitecture = \"skflo\"\n", "my.toml").expect_err("no network");
    assert!(error.to_string().contains("raft-small"), "{error}");
}

#[test]
fn every_key_can_be_overridden() {
    let config = Config::default();
    let table = Table::try_from(&config).expect("a table");
    for (section, keys) in &table {
        for (key, value) in keys.as_table().expect("a section") {
            let text = match value {
                Value::String(text) => text.clone(),
                other => other.to_string(),
            };
            let given = format!("{section}.{key}={text}");
            let same = config.with_override(&given).unwrap_or_else(|error| panic!("{given}: {error}"));
            assert_eq!(same, config, "{given}");
        }
    }
    let config = config.with_override("training.learning_rate=1e-3").expect("a number");
    assert_eq!(config.training.learning_rate, 1e-3);
    let config = config.with_override("data.train=folder:/data*3").expect("a dataset");
    assert_eq!(config.data.train[0].times, 3);
}

#[test]
fn wrong_overrides_list_the_keys() {
    let error = |given: &str| Config::default().with_override(given).expect_err(given).to_string();
    assert!(error("training.lr=1").contains("learning_rate"), "{}", error("training.lr=1"));
    assert!(error("train.batch=1").contains("training"));
    assert!(error("batch").contains("KEY=VALUE"));
    assert!(error("training.batch=many").contains("training.batch=many"));
    for given in ["training.batch=many", "training.batch=-1", "augmentation.max_shift=1.5"] {
        assert!(error(given).contains("expected a whole number from 0"), "{}", error(given));
    }
    assert!(error("loss.fdr=some").contains("expected a number"), "{}", error("loss.fdr=some"));
    assert!(
        error("data.train=5").contains("expected a text or a list of texts"),
        "{}",
        error("data.train=5")
    );
    let whole = Config::parse("training = 3\n", "my.toml").expect_err("no section").to_string();
    assert!(whole.contains("expected keys with values") && !whole.contains("Config"), "{whole}");
}

#[test]
fn wrong_settings_of_made_data_are_reported() {
    let error = |train: &str, keys: &str| {
        let text = format!("[data]\ntrain = \"{train}\"\ncrop = \"64x48\"\n{keys}");
        Config::parse(&text, "my.toml").expect(keys).check().expect_err(keys).to_string()
    };
    for (train, keys, parts) in [
        (
            "shapes:",
            "[data.shapes]\nsize = \"63x60\"",
            ["data.shapes.size = 63x60", "at least the crop, 64x48"],
        ),
        ("rendered:", "[data.rendered]\nsize = \"64x47\"", ["data.rendered.size = 64x47", "64x48"]),
        ("shapes:", "[data.shapes]\npairs = 0", ["data.shapes.pairs = 0", "1 to 99999"]),
        ("rendered:", "[data.rendered]\nscenes = 0", ["data.rendered.scenes = 0", "1 to 10000"]),
        ("rendered:", "[data.rendered]\nframes = 0", ["data.rendered.frames = 0", "1 to 1000"]),
        ("shapes:", "[training]\nclip_frames = 3", ["training.clip_frames = 3", "do not follow each other"]),
        (
            "rendered:",
            "[data.rendered]\nframes = 3\n[training]\nclip_frames = 5",
            ["data.rendered.frames = 3", "4 to 1000"],
        ),
        ("shapes:", "[validation]\ndata = \"shapes:\"", ["validation.data = shapes:", "in files"]),
    ] {
        let error = error(train, keys);
        assert!(parts.iter().all(|part| error.contains(part)), "{error}");
    }
    // What is not used is not checked.
    let config = Config::parse("[data]\ntrain = \"folder:a\"\n[data.shapes]\npairs = 0\n", "my.toml");
    config.expect("a configuration").check().expect("files alone");
    let unknown = Config::parse("[data.rendered.recording]\nnois = 1\n", "my.toml").expect_err("nois");
    assert!(unknown.to_string().contains("`noise`"), "{unknown}");
}

#[test]
fn made_frames_contain_the_crop() {
    for crop in ["320x320", "192x280", "512x800", "8x1000", "1x1"] {
        let data = Config::default().with_override(&format!("data.crop={crop}")).expect(crop).data;
        for size in [data.shapes_size(), data.rendered_size()] {
            assert!(size.width > data.crop.width && size.height > data.crop.height, "{crop}: {size}");
        }
    }
    let data = Config::default().with_override("data.crop=320x320").expect("a size").data;
    assert_eq!(
        (data.shapes_size().to_string(), data.rendered_size().to_string()),
        ("360x360".into(), "360x525".into())
    );
}

#[test]
fn invalid_numbers_are_reported() {
    for given in
        ["training.batch=0", "training.clip=-1", "training.rising=1", "loss.gamma=2", "data.workers=0"]
    {
        let config = Config::default().with_override(given).expect(given);
        let message = config.check().expect_err(given).to_string();
        assert!(message.starts_with(given.split('=').next().expect("a key")), "{message}");
    }
}

#[test]
fn an_unknown_precision_is_told_which_there_are() {
    let text = "[training]\nprecision = \"bf17\"";
    let error = Config::parse(text, "run.toml").unwrap_err().to_string();
    assert!(error.contains("`bf17` is not a precision; expected `f32`, `f16` or `bf16`"), "{error}");
}

#[test]
fn sources_are_parsed_from_the_end() {
    let source: Source = "sintel-clean:/data/a@b/Sintel@all*100".parse().unwrap();
    assert_eq!((source.split, source.times), (Some(Split::All), 100));
    assert_eq!(source.files().unwrap().dir.to_str(), Some("/data/a@b/Sintel"));
    for (text, kind, of) in [
        ("shapes:", MadeKind::Shapes, ""),
        ("shapes:/a b:c", MadeKind::Shapes, "/a b:c"),
        ("rendered:avatar:/a@ict:/c", MadeKind::Rendered, "avatar:/a@ict:/c"),
    ] {
        let source: Source = text.parse().unwrap();
        assert_eq!((source.to_string(), source.times), (text.to_owned(), 1));
        assert_eq!(source.made(), Some(&MadeSpec { kind, of: of.to_owned() }));
    }
    assert_eq!("rendered:*4".parse::<Source>().unwrap().times, 4);
    let error = "shapes:@val".parse::<Source>().unwrap_err();
    assert!(error.contains("no splits"), "{error}");
    let error = "shape:".parse::<Source>().unwrap_err();
    assert!(error.contains("shapes: or rendered:"), "{error}");
    for text in ["folder:/data", "folder:a*b", "srflow:x@val", "kitti:k*200", "folder:/a:b@train*3"] {
        let source: Source = text.parse().unwrap();
        assert_eq!(source.to_string(), text);
    }
    for wrong in ["", "/data", "folder:x*0", "nothing:/data*3"] {
        assert!(wrong.parse::<Source>().is_err(), "{wrong}");
    }
}
