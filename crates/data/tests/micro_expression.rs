//! Micro-expression datasets: the published annotations give the published counts, and every published layout is read.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use srflow_core::Image;
use srflow_data::micro_expression::{
    Annotation, CLIP_KINDS, Classes, ClipDataset, ClipSource, DropReason, Labels, count_classes,
    published_counts, write_plain,
};
use srflow_files::write_image_png;

/// The published annotation files, if they are next to the repository.
fn annotations() -> Option<PathBuf> {
    let here = std::env::current_dir().unwrap();
    let found = here.ancestors().map(|dir| dir.join("shared/data/me-annotations")).find(|dir| dir.is_dir());
    if found.is_none() {
        eprintln!("skipped: shared-data: no shared/data/me-annotations above {}", here.display());
    }
    found
}

const NEGATIVE: usize = 0;
const POSITIVE: usize = 1;
const SURPRISE: usize = 2;

fn source(text: &str) -> ClipSource {
    text.parse().unwrap()
}

fn at(kind: &str, dir: &Path) -> ClipSource {
    source(&format!("{kind}:{}", dir.display()))
}

fn read(kind: &str, dir: &Path) -> Labels {
    Labels::read(&at(kind, dir)).unwrap()
}

/// What is refused says each of these parts.
#[track_caller]
fn refuses<T, E: std::fmt::Display>(result: Result<T, E>, parts: &[&str]) {
    let Err(error) = result else { panic!("it was taken") };
    let error = error.to_string();
    for part in parts {
        assert!(error.contains(part), "`{part}` is not in: {error}");
    }
}

/// Negative, positive, surprise.
fn counts(labels: &Labels) -> Vec<usize> {
    count_classes(&Classes::default(), &labels.annotations)
}

fn dropped(labels: &Labels, reason: DropReason) -> usize {
    labels.dropped.iter().filter(|row| row.reason == reason).count()
}

#[test]
fn the_classes_of_megc2019_give_its_list() {
    let Some(dir) = annotations() else { return };
    // Subjects are `sub01`, `6` or `s01` in the list; SMIC's clips `s01_ne_01` or `s1_ne_01`.
    let key = |data: &str, subject: &str, clip: &str, class: usize| {
        let subject: u32 = subject.trim_start_matches(|c: char| !c.is_ascii_digit()).parse().unwrap();
        (data.to_owned(), subject, clip.trim().replacen("s0", "s", 1), class)
    };
    let list = fs::read_to_string(dir.join("combined_3_class_gt.csv")).unwrap();
    let of_line = |line: &str| {
        let [data, subject, clip, label] = line.split(',').collect::<Vec<_>>()[..] else { panic!("{line}") };
        key(data, subject, clip, label.parse().unwrap())
    };
    let listed: BTreeSet<_> = list.lines().skip(1).map(of_line).collect();
    assert_eq!(listed.len(), 442);
    let classes = Classes::open("megc2019").unwrap();
    let mut found = BTreeSet::new();
    for kind in ["samm", "casme2", "smic"] {
        let source = ClipSource { classes: classes.clone(), ..at(kind, &dir) };
        let labels = Labels::read(&source).unwrap();
        found.extend(labels.annotations.iter().map(|a| key(kind, &a.subject, &a.clip, a.class)));
    }
    // The spreadsheet of SMIC that is published with the apex lists lacks their seven clips.
    let absent: Vec<_> = listed
        .difference(&found)
        .map(|(data, _, clip, class)| (data.as_str(), clip.as_str(), *class))
        .collect();
    let seven = [
        ("smic", "s1_ne_02", 0),
        ("smic", "s2_sur_05", 2),
        ("smic", "s3_ne_03", 0),
        ("smic", "s3_ne_20", 0),
        ("smic", "s4_ne_05", 0),
        ("smic", "s4_ne_06", 0),
        ("smic", "s9_sur_02", 2),
    ];
    assert_eq!(absent, seven);
    assert!(found.is_subset(&listed));
    let counts =
        |class: usize| listed.iter().filter(|(data, _, _, found)| data == "smic" && *found == class).count();
    assert_eq!(published_counts(&classes, "smic"), Some([counts(0), counts(1), counts(2)]));
}

#[test]
fn the_clips_that_apex_lists_lack_belong_to_megc2019() {
    let folder = tempfile::tempdir().unwrap();
    let rows = "Subject,Filename,OnsetF,OffsetF,Onset2F,Emotion\ns1,s1_ne_02,3,9,3,negative\ns1,s1_ne_03,3,9,3,negative\n";
    fs::write(folder.path().join("annotation.csv"), rows).unwrap();
    let kept = |classes: Classes| {
        let source = ClipSource { classes, ..at("smic", folder.path()) };
        Labels::read(&source).unwrap().annotations.len()
    };
    assert_eq!(kept(Classes::default()), 1);
    assert_eq!(kept(Classes::open("megc2019").unwrap()), 2);
}

#[test]
fn samm_gives_the_published_counts() {
    let Some(dir) = annotations() else { return };
    let labels = read("samm", &dir);
    assert_eq!(counts(&labels), [92, 26, 15]);
    assert_eq!(published_counts(&Classes::default(), "samm"), Some([92, 26, 15]));
    assert_eq!((labels.dropped.len(), dropped(&labels, DropReason::Label)), (26, 26));
    let subjects: BTreeSet<&str> = labels.annotations.iter().map(|a| a.subject.as_str()).collect();
    assert_eq!(subjects.len(), 28);
    assert!(subjects.contains("006") && !subjects.contains("025"));
    let first = &labels.annotations[0];
    let frames = (first.onset, first.apex, first.offset);
    assert_eq!(
        (first.clip.as_str(), first.label.as_str(), frames),
        ("006_1_2", "Anger", (5562, Some(5588), 5632))
    );
    assert_eq!((first.action_units.as_str(), labels.annotations[1].action_units.as_str()), ("4+7", "4"));
}

#[test]
fn casme2_gives_the_published_counts() {
    let Some(dir) = annotations() else { return };
    let labels = read("casme2", &dir);
    assert_eq!(counts(&labels), [88, 32, 25]);
    let subjects: BTreeSet<&str> = labels.annotations.iter().map(|a| a.subject.as_str()).collect();
    assert_eq!(subjects.len(), 24);
    let row = |reason| labels.dropped.iter().find(|row| row.reason == reason).unwrap();
    let unknown = row(DropReason::ApexUnknown);
    assert_eq!((unknown.subject.as_str(), unknown.clip.as_str()), ("04", "EP12_01f"));
    let still = row(DropReason::ApexNotAfterOnset);
    assert_eq!((still.subject.as_str(), still.clip.as_str()), ("05", "EP09_05f"));
    assert_eq!(dropped(&labels, DropReason::Label), 99 + 7 + 2, "others, sadness and fear");
    assert_eq!(labels.annotations.len() + labels.dropped.len(), 255);
}

#[test]
fn smic_goes_by_the_names_of_its_clips_and_takes_the_published_apexes() {
    let Some(dir) = annotations() else { return };
    let labels = read("smic", &dir);
    assert_eq!(counts(&labels), [65, 51, 41]);
    let subjects: BTreeSet<&str> = labels.annotations.iter().map(|a| a.subject.as_str()).collect();
    assert_eq!(subjects.len(), 16);
    let mislabelled = labels.annotations.iter().find(|a| a.clip == "s18_sur_03").unwrap();
    assert_eq!((mislabelled.class, mislabelled.label.as_str()), (SURPRISE, "negative"));
    assert!(labels.annotations.iter().all(|a| a.apex.is_some_and(|apex| apex > a.onset && apex <= a.offset)));
    let first = labels.annotations.iter().find(|a| a.clip == "s20_ne_01").unwrap();
    assert_eq!(first.apex, Some(17_581_046));
}

#[test]
fn the_composite_is_the_papers() {
    let Some(dir) = annotations() else { return };
    let all = ["samm", "casme2", "smic"].map(|kind| read(kind, &dir));
    let together = count_classes(&Classes::default(), all.iter().flat_map(|labels| &labels.annotations));
    assert_eq!(together, [245, 109, 81]);
    let subjects: BTreeSet<(&str, &str)> = all
        .iter()
        .flat_map(|labels| labels.annotations.iter().map(|a| (labels.dataset.as_str(), a.subject.as_str())))
        .collect();
    assert_eq!(subjects.len(), 68);
}

/// The labels of a dataset under another set of classes, and the number of clips per class.
fn divided(kind: &str, dir: &Path, classes: &str) -> (Labels, Vec<usize>) {
    let classes = Classes::open(classes).unwrap();
    let labels = Labels::read(&ClipSource { classes: classes.clone(), ..at(kind, dir) }).unwrap();
    let counts = count_classes(&classes, &labels.annotations);
    (labels, counts)
}

#[test]
fn other_classes_give_the_counts_of_the_literature() {
    let Some(dir) = annotations() else { return };
    // 246 clips; two of disgust have no usable apex, which can be spotted.
    assert_eq!(divided("casme2", &dir, "casme2-5").1, [32, 63 - 2, 27, 25, 99]);
    let spotted = |classes: &str| {
        let classes = Classes::open(classes).unwrap();
        let source = ClipSource { classes: classes.clone(), spots_apexes: true, ..at("casme2", &dir) };
        count_classes(&classes, &Labels::read(&source).unwrap().annotations)
    };
    assert_eq!(spotted("casme2-5"), [32, 63, 27, 25, 99]);
    assert_eq!(spotted("megc2019"), [88, 32, 25], "its list leaves them out");
    assert_eq!(divided("samm", &dir, "samm-4").1, [57, 26, 15, 12]);
    assert_eq!(divided("samm", &dir, "samm-5").1, [57, 26, 15, 12, 26]);
    // MEGC 2018: 185 clips of 26 subjects and 68 of 21. One of class III has no apex.
    let (casme2, counts) = divided("casme2", &dir, "objective-5");
    assert_eq!(counts, [25, 15, 99 - 1, 26, 20]);
    assert_eq!(dropped(&casme2, DropReason::ApexUnknown), 1);
    let (samm, counts) = divided("samm", &dir, "objective-5");
    assert_eq!(counts, [24, 13, 20, 8, 3]);
    let subjects =
        |labels: &Labels| labels.annotations.iter().map(|a| a.subject.clone()).collect::<BTreeSet<_>>().len();
    assert_eq!((subjects(&casme2), subjects(&samm)), (26, 21));
    let all = ["samm", "casme2"].map(|kind| divided(kind, &dir, "objective-7").1.iter().sum::<usize>());
    assert_eq!(all, [159, 255 - 2]);
}

/// Objective classes follow from action units: the published table nearly reproduces the published classes.
#[test]
fn classes_of_action_units_are_those_of_the_coding() {
    let Some(dir) = annotations() else { return };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mine.toml");
    let text = r#"
        [[class]]
        name = "I"
        action_units = ["6", "12", "6+12", "6+7+12", "7+12"]
        [[class]]
        name = "II"
        action_units = ["1+2", "5", "25", "1+2+25", "25+26", "5+24"]
        [[class]]
        name = "frown"
        action_units = ["4+*"]
    "#;
    fs::write(&path, text).unwrap();
    let (labels, counts) = divided("casme2", &dir, path.to_str().unwrap());
    assert_eq!(counts[..2], [24, 15], "one more of class I is coded 6+12+17");
    assert!(labels.annotations.iter().filter(|a| a.class == 2).all(|a| a.action_units.contains('4')));
    assert!(counts[2] > 100, "{counts:?}");
}

#[test]
fn a_dataset_without_a_clip_of_any_class_is_refused() {
    let Some(dir) = annotations() else { return };
    let classes = Classes::open("objective-5").unwrap();
    let smic = ClipSource { classes: classes.clone(), ..at("smic", &dir) };
    refuses(Labels::read(&smic), &["smic: no clip belongs to one of the classes I, II, III, IV, V"]);
    let alone = tempfile::tempdir().unwrap();
    fs::copy(dir.join("CASME2-coding-20140508.xlsx"), alone.path().join("coding.xlsx")).unwrap();
    let casme2 = ClipSource { classes, ..at("casme2", alone.path()) };
    refuses(Labels::read(&casme2), &["CASME2-ObjectiveClasses.xlsx"]);
}

#[test]
fn plain_clips_take_any_classes() {
    let folder = tempfile::tempdir().unwrap();
    let rows = "clip,subject,onset,apex,offset,class,action_units\n\
        a,s,1,2,3,Happiness,\nb,s,1,2,3,others,\nc,s,1,2,3,fear,\nd,s,1,2,3,1,\n";
    fs::write(folder.path().join("clips.csv"), rows).unwrap();
    let (labels, counts) = divided("clips", folder.path(), "casme2-5");
    assert_eq!(counts, [1, 1, 0, 0, 1], "happiness, the number 1, others");
    assert_eq!((labels.dropped.len(), labels.dropped[0].label.as_str()), (1, "fear"));
}

/// As pandas, Excel in other languages and Excel's "CSV UTF-8" write it.
#[test]
fn tables_of_other_programs_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let mut rows = "\u{feff}Clip;Subject;Onset;Apex;Offset;Class\r\n".to_owned();
    rows += "a;s;1.0;;3.00;positive\r\nb;s;1.0;19.0;20.0;\"negative\"\r\n";
    fs::write(folder.path().join("clips.csv"), rows).unwrap();
    let labels = read("clips", folder.path());
    let frames: Vec<_> = labels.annotations.iter().map(|a| (a.onset, a.apex, a.offset)).collect();
    assert_eq!(frames, [(1, None, 3), (1, Some(19), 20)]);
    fs::write(
        folder.path().join("clips.csv"),
        "clip,subject,onset,apex,offset,class\na,s,1.5,2,3,positive\n",
    )
    .unwrap();
    refuses(Labels::read(&at("clips", folder.path())), &["row 2: onset: expected a frame number", "1.5"]);

    let table = "Subject,Filename,OnsetFrame,ApexFrame,OffsetFrame,Action Units,Estimated Emotion\n\
        1,EP02_01f,46,59,86,4,happiness\n";
    fs::write(folder.path().join("coding.csv"), table).unwrap();
    let labels = read("casme2", folder.path());
    assert_eq!((labels.annotations[0].subject.as_str(), labels.annotations[0].apex), ("01", Some(59)));
    fs::remove_file(folder.path().join("coding.csv")).unwrap();
    fs::write(folder.path().join("coding.xls"), b"\xd0\xcf\x11\xe0\xa1\xb1").unwrap();
    refuses(Labels::read(&at("casme2", folder.path())), &["coding.xls", "expected a valid .xls spreadsheet"]);
}

/// The list published with CapsuleNet holds onset, apex and class of each of the 435 clips.
#[test]
fn every_clip_agrees_with_the_published_list() {
    let Some(dir) = annotations() else { return };
    let mut rows = csv::Reader::from_path(dir.join("data_apex.csv")).unwrap();
    let mut listed = BTreeSet::new();
    for row in rows.records() {
        let row = row.unwrap();
        // The list has samm 6 and casme2 sub01.
        let subject: u32 = row[1].trim_start_matches("sub").parse().unwrap();
        let class = if &row[2] == "s18_sur_03" { "2" } else { &row[3] };
        listed.insert(format!("{} {subject} {} {class} {} {}", &row[0], &row[2], &row[4], &row[5]));
    }
    let mut read_here = BTreeSet::new();
    for kind in ["samm", "casme2", "smic"] {
        for a in read(kind, &dir).annotations {
            let subject: u32 = a.subject.parse().unwrap();
            let apex = a.apex.unwrap();
            read_here.insert(format!("{kind} {subject} {} {} {} {apex}", a.clip, a.class, a.onset));
        }
    }
    assert_eq!(listed.len(), 435);
    assert_eq!(listed, read_here);
}

#[test]
fn mixed_up_spreadsheets_are_recognized() {
    let Some(dir) = annotations() else { return };
    let file = |name: &str| Some(dir.join(name));
    let samm = file("SAMM_Micro_FACS_Codes_v2.xlsx");
    let given =
        |kind: &str, annotations| Labels::read(&ClipSource { annotations, ..at(kind, Path::new("nowhere")) });
    refuses(given("casme2", samm.clone()), &["those of SAMM", "OnsetFrame"]);
    refuses(given("samm", file("CASME2-coding-20140508.xlsx")), &["those of CASME II"]);
    refuses(given("smic", samm), &["those of SAMM"]);
    refuses(given("casme2", file("CASME2-ObjectiveClasses.xlsx")), &["ApexFrame", "Objective Class"]);
    refuses(given("samm", file("smic_apex.csv")), &["smic_apex.csv", "Filename"]);
}

#[test]
fn a_wrong_root_is_refused_with_the_expected_path() {
    let empty = tempfile::tempdir().unwrap();
    for kind in ["samm", "casme2", "smic"] {
        refuses(Labels::read(&at(kind, empty.path())), &[".xlsx", "`annotations`"]);
    }
    refuses(Labels::read(&at("clips", empty.path())), &["clips.csv", "is empty"]);
    refuses(Labels::read(&source("samm:/no/such/folder")), &["/no/such/folder"]);
}

/// Empty files suffice: finding frames decodes nothing.
fn touch(folder: &Path, names: impl IntoIterator<Item = String>) {
    fs::create_dir_all(folder).unwrap();
    for name in names {
        fs::write(folder.join(name), "").unwrap();
    }
}

/// All frames of every clip of the three datasets, with their published names.
fn frames_of(kind: &str, labels: &Labels, root: &Path) {
    for (at, a) in labels.annotations.iter().enumerate() {
        let numbers = a.onset..=a.offset;
        match kind {
            "samm" => {
                let digits = if at % 4 == 0 { 4 } else { 5 }; // as the clips do
                let name = |n| format!("{}_{n:0digits$}.jpg", a.subject);
                touch(&root.join(&a.subject).join(&a.clip), numbers.map(name));
            }
            "casme2-raw" => {
                let folder = root.join("CASME2_RAW_selected").join(format!("sub{}", a.subject)).join(&a.clip);
                touch(&folder, numbers.map(|n| format!("img{n}.jpg")));
            }
            "casme2-cropped" => {
                let folder = root.join("Cropped_original").join(format!("sub{}", a.subject)).join(&a.clip);
                touch(&folder, numbers.map(|n| format!("reg_img{n}.jpg")));
            }
            "smic" => {
                let folder = root.join("HS_long/SMIC_HS_E").join(format!("s{}", a.subject)).join(&a.clip);
                touch(&folder, numbers.map(|n| format!("image{n:06}.jpg")));
            }
            "smic-short" => {
                let class = ["negative", "positive", "surprise"][a.class];
                let subject = a.clip.split('_').next().unwrap();
                let folder = root.join("HS").join(subject).join("micro").join(class).join(&a.clip);
                touch(&folder, numbers.map(|n| format!("image{n:06}.jpg")));
            }
            _ => unreachable!(),
        }
    }
}

/// The first clips of each subject: enough to check that folders are found.
fn few(mut labels: Labels) -> Labels {
    let mut seen = BTreeSet::new();
    labels.annotations.retain(|a| seen.insert(a.subject.clone()) && seen.len() <= 6);
    labels
}

#[test]
fn every_published_layout_is_found() {
    let Some(dir) = annotations() else { return };
    for (kind, text, form) in [
        ("samm", "samm", ""),
        ("casme2-raw", "casme2", "raw"),
        ("casme2-cropped", "casme2-cropped", "cropped"),
        ("smic", "smic", "extended"),
        ("smic-short", "smic", "short"),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let source = ClipSource {
            annotations: (kind != "smic-short").then(|| {
                let name = match &text[..4] {
                    "samm" => "SAMM_Micro_FACS_Codes_v2.xlsx",
                    "casm" => "CASME2-coding-20140508.xlsx",
                    _ => "SMIC-HS-E_annotation.xlsx",
                };
                dir.join(name)
            }),
            apex_list: Some(dir.join("data_apex.csv")),
            ..at(text, folder.path())
        };
        let labels = few(read(&text[..text.find('-').unwrap_or(text.len())], &dir));
        frames_of(kind, &labels, folder.path());
        let dataset = ClipDataset::open(&source, true).unwrap_or_else(|error| panic!("{kind}: {error}"));
        assert_eq!((dataset.clips.len(), dataset.form), (labels.annotations.len(), form), "{kind}");
        for clip in &dataset.clips {
            let a = labels
                .annotations
                .iter()
                .find(|a| (&a.subject, &a.clip) == (&clip.annotation.subject, &clip.annotation.clip));
            let a = a.unwrap_or_else(|| panic!("{kind}: {} was not made", clip.id()));
            if kind != "smic-short" {
                assert_eq!(&clip.annotation, a, "{kind}");
            }
            assert_eq!(clip.frames.len() as u64, a.offset - a.onset + 1);
            assert!(clip.frame(a.apex.unwrap()).is_some_and(Path::is_file));
            assert_eq!(clip.frame(a.offset + 1), None);
        }
    }
}

#[test]
fn both_releases_of_casme2_want_a_choice() {
    let Some(dir) = annotations() else { return };
    let folder = tempfile::tempdir().unwrap();
    let labels = few(read("casme2", &dir));
    frames_of("casme2-raw", &labels, folder.path());
    frames_of("casme2-cropped", &labels, folder.path());
    let open = |kind: &str| {
        let annotations = Some(dir.join("CASME2-coding-20140508.xlsx"));
        ClipDataset::open(&ClipSource { annotations, ..at(kind, folder.path()) }, true)
    };
    refuses(open("casme2"), &["casme2-raw:", "casme2-cropped:"]);
    assert_eq!(open("casme2-raw").unwrap().form, "raw");
    let cropped = open("casme2-cropped").unwrap();
    assert!(cropped.clips[0].frames.values().all(|path| path.to_str().unwrap().contains("/reg_img")));
}

fn row(clip: &str, subject: &str, class: usize, frames: (u64, Option<u64>, u64)) -> Annotation {
    Annotation {
        subject: subject.to_owned(),
        clip: clip.to_owned(),
        class,
        label: Classes::default().names()[class].clone(),
        action_units: "1+2".to_owned(),
        onset: frames.0,
        apex: frames.1,
        offset: frames.2,
    }
}

#[test]
fn plain_clips_are_read_back_as_written() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().join("mine");
    let rows = [
        row("anna/first clip", "anna", SURPRISE, (3, Some(5), 9)),
        row("ben/1", "ben, the second", NEGATIVE, (0, None, 4)),
    ];
    for a in &rows {
        touch(&root.join(&a.clip), (0..12).map(|n| format!("frame{n:03}.png")));
    }
    write_plain(&root.join("clips.csv"), &Classes::default(), &rows).unwrap();
    for given in [root.clone(), root.join("clips.csv")] {
        let dataset = ClipDataset::open(&at("clips", &given), false).unwrap();
        assert_eq!(dataset.name, "mine");
        assert_eq!(dataset.clips.iter().map(|clip| clip.annotation.clone()).collect::<Vec<_>>(), rows);
        assert_eq!(dataset.clips[0].id(), "mine/anna/anna/first clip");
        assert_eq!(dataset.clips[0].frames.keys().copied().collect::<Vec<_>>(), [3, 4, 5, 6, 7, 8, 9]);
    }
}

/// With the line ends of Excel and Python's `csv`.
#[test]
fn lines_may_end_in_cr_lf() {
    let folder = tempfile::tempdir().unwrap();
    let text = "clip,subject,onset,apex,offset,class\r\na,s,1,2,3,positive\r\nb,s,1,2,3,negative\r\n";
    fs::write(folder.path().join("clips.csv"), text).unwrap();
    assert_eq!(counts(&read("clips", folder.path())), [1, 1, 0]);
    fs::write(folder.path().join("clips.csv"), text.replace("negative", "glad")).unwrap();
    refuses(Labels::read(&at("clips", folder.path())), &["row 3: class: `glad`"]);
}

#[test]
fn rows_that_cannot_be_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let read = |text: &str| {
        fs::write(folder.path().join("clips.csv"), text).unwrap();
        Labels::read(&at("clips", folder.path()))
    };
    let header = "clip,subject,onset,apex,offset,class\n";
    for (row, expected) in [
        ("a,s,5,5,9,positive\n", "row 3: expected onset < apex <= offset, found onset 5, apex 5"),
        ("a,s,5,7,6,positive\n", "row 3"),
        ("a,s,x,7,9,positive\n", "onset: expected a frame number, found `x`"),
        ("a,s,1,7,9,happy\n", "`happy` is not a class"),
        ("a,,1,7,9,2\n", "subject: expected a value"),
        ("good,s,1,2,3,0\n", "clip good exists twice"),
        ("a,s,1,7,99999999999999999999999,0\n", "offset: expected a frame number"),
    ] {
        refuses(read(&format!("{header}good,s,1,2,3,negative\n{row}")), &[expected, "clips.csv"]);
    }
    refuses(read("clip,subject,onset,apex,class\n"), &["offset", "its first row holds clip, subject"]);
    refuses(read(""), &["it is empty"]);
}

#[test]
fn missing_frames_are_named_and_counted() {
    let folder = tempfile::tempdir().unwrap();
    let rows = [
        row("a", "1", POSITIVE, (10, Some(15), 20)),
        row("b", "1", NEGATIVE, (10, Some(15), 20)),
        row("gone", "2", NEGATIVE, (1, Some(2), 3)),
        row("whole", "2", SURPRISE, (1, Some(2), 3)),
    ];
    let without = |skipped: &[u64]| {
        let numbers: Vec<u64> = (0..30).filter(|n| !skipped.contains(n)).collect();
        numbers.into_iter().map(|n| format!("img{n}.jpg"))
    };
    touch(&folder.path().join("a"), without(&[12, 13, 17]));
    touch(&folder.path().join("b"), without(&[15]));
    touch(&folder.path().join("whole"), without(&[]));
    write_plain(&folder.path().join("clips.csv"), &Classes::default(), &rows).unwrap();
    let source = at("clips", folder.path());
    let expected = [
        "7 frames of 3 clips",
        "1/a: 3 frames: 12-13, 17",
        "1/b: 1 frame: 15",
        "2/gone: 3 frames: 1-3 (no folder",
        "`allow_missing`",
    ];
    refuses(ClipDataset::open(&source, false), &expected);

    let dataset = ClipDataset::open(&source, true).unwrap();
    let kept: Vec<&str> = dataset.clips.iter().map(|clip| clip.annotation.clip.as_str()).collect();
    assert_eq!(kept, ["a", "whole"], "b has no apex");
    assert_eq!(
        dataset.missing.iter().map(|m| (m.clip.as_str(), m.count(), m.dropped)).collect::<Vec<_>>(),
        [("a", 3, false), ("b", 1, true), ("gone", 3, true),]
    );
    assert!(dataset.dropped.iter().all(|row| row.reason == DropReason::FramesMissing));
}

#[test]
fn key_frames_alone_are_taken_when_that_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let rows = [
        row("annotated", "1", POSITIVE, (10, Some(15), 20)),
        row("between", "1", NEGATIVE, (10, None, 20)),
        row("two between", "2", NEGATIVE, (10, None, 20)),
        row("no apex frame", "2", SURPRISE, (10, Some(15), 20)),
    ];
    for (clip, numbers) in [
        ("annotated", &[10, 15, 20][..]),
        ("between", &[10, 13, 20]),
        ("two between", &[10, 13, 14, 20]),
        ("no apex frame", &[10, 20]),
    ] {
        touch(&folder.path().join(clip), numbers.iter().map(|n| format!("f_{n:04}.png")));
    }
    write_plain(&folder.path().join("clips.csv"), &Classes::default(), &rows).unwrap();
    let source = at("clips", folder.path());
    refuses(ClipDataset::open(&source, false), &["32 frames of 4 clips", "`only_key_frames`"]);

    let key_frames = ClipSource { only_key_frames: true, ..source };
    let error = ClipDataset::open(&key_frames, false).unwrap_err().to_string();
    assert!(error.contains("2/no apex frame: 1 frame: 15"), "{error}");
    assert!(error.contains("2/two between: 7 frames: 11-12, 15-19"), "where to spot the apex: {error}");
    assert!(!error.contains("annotated"), "{error}");
    let dataset = ClipDataset::open(&key_frames, true).unwrap();
    let apexes: Vec<_> =
        dataset.clips.iter().map(|c| (c.annotation.clip.as_str(), c.annotation.apex)).collect();
    assert_eq!(apexes, [("annotated", Some(15)), ("between", Some(13)), ("two between", None)]);
}

#[test]
fn a_frame_that_is_there_twice_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    write_plain(
        &folder.path().join("clips.csv"),
        &Classes::default(),
        &[row("a", "1", POSITIVE, (1, Some(2), 3))],
    )
    .unwrap();
    touch(&folder.path().join("a"), (1..4).map(|n| format!("img{n}.jpg")));
    write_image_png(&folder.path().join("a/img02.png"), &Image::new(4, 4)).unwrap();
    refuses(ClipDataset::open(&at("clips", folder.path()), true), &["frame 2 exists twice"]);
}

/// A dataset of one clip, whose frames 1 to 3 have these names.
fn clip_of(names: &[&str]) -> (tempfile::TempDir, ClipSource) {
    let folder = tempfile::tempdir().unwrap();
    let rows = [row("a", "1", POSITIVE, (1, Some(2), 3))];
    write_plain(&folder.path().join("clips.csv"), &Classes::default(), &rows).unwrap();
    touch(&folder.path().join("a"), names.iter().map(|name| (*name).to_owned()));
    let source = at("clips", folder.path());
    (folder, source)
}

#[test]
fn the_number_of_a_frame_is_the_one_that_counts() {
    for names in [
        ["img1_200fps.jpg", "img2_200fps.jpg", "img3_200fps.jpg"].as_slice(),
        &["img (1).jpg", "img (2).jpg", "img (3).jpg"],
        &["img1.jpg", "img2.jpg", "img2 (1).jpg", "img2 - Copy.jpg", "img3.jpg"],
        &["img1.jpg", "img2 (1).jpg", "img3.jpg"],
        &["t-1.jpg", "t0.jpg", "t1.jpg", "t2.jpg", "t3.jpg"],
    ] {
        let (_folder, source) = clip_of(names);
        let dataset = ClipDataset::open(&source, false).unwrap();
        assert_eq!(dataset.clips[0].frames.keys().copied().collect::<Vec<_>>(), [1, 2, 3], "{names:?}");
    }
    let (_folder, source) = clip_of(&["img2.jpg", "img3.jpg", "img3 (1).jpg"]);
    refuses(ClipDataset::open(&source, false), &["1/a: 1 frame: 1\n"]);
    let (_folder, source) = clip_of(&["a_200fps.jpg", "b_200fps.jpg", "c_200fps.jpg"]);
    refuses(ClipDataset::open(&source, false), &["found 200 in all 3", "a_200fps.jpg", "number the files"]);
}

#[test]
fn frames_that_are_not_read_are_named() {
    let (_folder, source) = clip_of(&["img1.gif", "img2.gif", "img3.GIF"]);
    let expected = ["1/a: 3 frames: 1-3 (the folder has 3 .gif files", "convert the files that are there"];
    refuses(ClipDataset::open(&source, false), &expected);
}

#[test]
fn the_page_on_micro_expressions_lists_every_kind() {
    let page = fs::read_to_string("../../docs/reference/micro-expression-files.md").unwrap();
    for kind in &CLIP_KINDS {
        let releases = kind.releases.iter().map(|release| format!("{}-{release}", kind.name));
        for word in releases.chain([kind.name.to_owned()]) {
            assert!(
                page.contains(&format!("| `{word}` |")),
                "docs/reference/micro-expression-files.md lacks {word}"
            );
            assert_eq!(source(&format!("{word}:dir")).to_string(), format!("{word}:dir"));
        }
    }
}
