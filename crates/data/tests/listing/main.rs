//! Every reader lists the published tree of its dataset, and reports what is missing from an incomplete one.

mod chairs;
mod clips;
mod facialflownet;
mod folder;
mod hd1k;
mod kitti;
mod sintel;
mod spring;
mod srflow;
mod things;

use std::fs;
use std::path::Path;

use srflow_data::flow::{DatasetSpec, EntryFile, FlowDataset, KINDS, Occlusion, Split};
use tempfile::TempDir;

/// A folder of empty files.
struct Tree(TempDir);

impl Tree {
    fn of<S: AsRef<str>>(files: impl IntoIterator<Item = S>) -> Self {
        let tree = Self(TempDir::new().unwrap());
        tree.add(files);
        tree
    }

    fn path(&self) -> &Path {
        self.0.path()
    }

    fn add<S: AsRef<str>>(&self, files: impl IntoIterator<Item = S>) {
        for file in files {
            let path = self.path().join(file.as_ref());
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, "").unwrap();
        }
    }

    fn remove(&self, file: &str) {
        fs::remove_file(self.path().join(file)).unwrap();
    }

    /// The file as entries have it.
    fn file(&self, name: &str) -> Option<EntryFile> {
        Some(self.path().join(name).into())
    }

    #[track_caller]
    fn open(&self, kind: &str, split: Option<Split>) -> FlowDataset {
        open(kind, self.path(), split).unwrap()
    }

    #[track_caller]
    fn refuses(&self, kind: &str, split: Option<Split>, parts: &[&str]) {
        assert_says(open(kind, self.path(), split), parts);
    }
}

fn open(kind: &str, dir: &Path, split: Option<Split>) -> Result<FlowDataset, String> {
    let spec = DatasetSpec { kind: kind.to_owned(), dir: dir.to_owned() };
    FlowDataset::open(&spec, split).map_err(|error| error.to_string())
}

/// The pairs as `id: frame1 > frame2 = flow`, with paths relative to the dataset's folder.
fn listed(dataset: &FlowDataset) -> Vec<String> {
    let seen = |path: &Path| path.strip_prefix(dataset.dir()).unwrap().display().to_string();
    let line = |entry: &srflow_data::flow::Entry| {
        let flow = entry.flow.as_ref().map_or("none".to_owned(), |flow| seen(&flow.path()));
        format!("{}: {} > {} = {flow}", entry.id(), seen(&entry.frame1.path()), seen(&entry.frame2.path()))
    };
    dataset.entries().iter().map(line).collect()
}

fn ids(dataset: &FlowDataset) -> Vec<String> {
    dataset.entries().iter().map(|entry| entry.id()).collect()
}

#[track_caller]
fn assert_says(result: Result<FlowDataset, String>, parts: &[&str]) {
    let error = result.expect_err("this dataset must not open");
    for part in parts {
        assert!(error.contains(part), "`{part}` is not in: {error}");
    }
}

#[test]
fn kinds_take_their_options_in_any_order_and_no_others() {
    let name = |text: &str| text.parse::<DatasetSpec>().map(|spec| spec.kind).map_err(|e| e.to_string());
    assert_eq!(name("things-right-final-backward:C:\\data").unwrap(), "things-right-final-backward");
    assert_eq!("hd1k:C:\\data".parse::<DatasetSpec>().unwrap().dir, Path::new("C:\\data"));
    for text in ["/data/Sintel", "sintel", ":dir", "sintel:", ""] {
        assert!(name(text).unwrap_err().contains("expected KIND:DIR"), "{text}");
    }
    assert!(name("sintle:dir").unwrap_err().contains("Kinds: srflow"));
    assert!(
        name("sintel-albedo:dir")
            .unwrap_err()
            .contains("`albedo` is not an option here; sintel takes one of each: clean|final")
    );
    assert!(name("sintel-clean-final:dir").unwrap_err().contains("`final`"));
    assert!(name("hd1k-clean:dir").unwrap_err().contains("hd1k takes none"));
}

#[test]
fn every_option_that_the_list_names_is_taken() {
    for kind in &KINDS {
        for option in kind.options.iter().copied().flatten() {
            let text = format!("{}-{option}:dir", kind.name);
            assert!(text.parse::<DatasetSpec>().is_ok(), "{text}");
        }
    }
}

#[test]
fn the_page_on_datasets_lists_every_kind_with_its_options() {
    let page = fs::read_to_string("../../docs/reference/datasets.md").unwrap();
    for kind in &KINDS {
        let options: Vec<String> =
            kind.options.iter().map(|choices| format!("`{}`", choices.join("`, `"))).collect();
        let row = format!("| `{}` | {} |", kind.name, options.join("; ")).replace("|  |", "| |");
        assert!(page.contains(&row), "docs/reference/datasets.md lacks {row}");
    }
}

#[test]
fn every_kind_reports_empty_and_missing_folders() {
    let empty = TempDir::new().unwrap();
    let missing = empty.path().join("no").join("such");
    let file = empty.path().with_extension("file");
    fs::write(&file, "").unwrap();
    for kind in KINDS.iter().map(|kind| kind.name) {
        assert_says(open(kind, empty.path(), None), &[kind, "looked for", "is empty"]);
        assert_says(
            open(kind, &missing, None),
            &["looked for", &format!("there is no {}", missing.display())],
        );
    }
}

#[test]
fn the_folder_above_or_below_is_pointed_out() {
    let dir = Tree::of([
        "Sintel/training/final/alley_1/frame_0001.png",
        "Sintel/training/flow/alley_1/frame_0001.flo",
    ]);
    let right = dir.path().join("Sintel");
    let advice = format!("give sintel-final:{}", right.display());
    dir.refuses("sintel-final", None, &["looked for", "training/final", &advice]);
    assert_says(open("sintel-final", &right.join("training"), None), &[&advice]);
    assert_says(open("sintel-final", &right.join("training/flow"), None), &[&advice]);
    let other = Tree::of(["pairs/frames/0.png", "pairs/frames/1.png"]);
    let advice = format!("give folder:{}", other.path().join("pairs").display());
    assert_says(open("folder", &other.path().join("pairs/frames"), None), &[&advice]);
    assert_says(open("folder", other.path(), None), &[&advice]);
    assert_says(open("sintel-clean", &right, None), &["training/clean", "training holds only final, flow"]);
}

#[test]
fn frames_come_in_natural_order() {
    let frames = ["10", "9", "100", "1"].map(|n| format!("frames/frame{n}.png"));
    let dir = Tree::of(frames);
    let dataset = dir.open("folder", None);
    assert_eq!(ids(&dataset), ["frame1", "frame9", "frame10"]);
}
