//! Clip datasets beside SAMM, CASME II and SMIC-HS: annotations in their published form, with the known mistakes, and the published
//! folders. The values are invented.

use std::fs;
use std::io::{Cursor, Write as _};
use std::path::Path;

use srflow_data::micro_expression::intervals::IntervalSource;
use srflow_data::micro_expression::{Classes, ClipDataset, ClipSource, DropReason, Labels, count_classes};

/// A dataset of these files; frames are empty, since finding them decodes nothing.
struct Dataset(tempfile::TempDir);

impl Dataset {
    fn new(files: &[(&str, &str)]) -> Self {
        let folder = Self(tempfile::tempdir().unwrap());
        for (name, text) in files {
            folder.write(name, text.as_bytes());
        }
        folder
    }

    fn path(&self) -> &Path {
        self.0.path()
    }

    fn write(&self, name: &str, bytes: &[u8]) {
        let path = self.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, bytes).unwrap();
    }

    /// Frames whose names have `#` where the number is.
    fn frames(&self, pattern: &str, numbers: std::ops::RangeInclusive<u64>) {
        for number in numbers {
            self.write(&pattern.replace('#', &number.to_string()), b"");
        }
    }

    fn source(&self, kind: &str, classes: &str) -> ClipSource {
        let source: ClipSource = format!("{kind}:{}", self.path().display()).parse().unwrap();
        ClipSource { classes: Classes::open(classes).unwrap(), ..source }
    }

    fn labels(&self, kind: &str, classes: &str) -> Labels {
        Labels::read(&self.source(kind, classes)).unwrap()
    }

    #[track_caller]
    fn open(&self, kind: &str, classes: &str) -> ClipDataset {
        ClipDataset::open(&self.source(kind, classes), false).unwrap_or_else(|error| panic!("{error}"))
    }
}

/// `subject/clip onset-apex-offset class`.
fn listed(labels: &Labels) -> Vec<String> {
    let apex = |apex: Option<u64>| apex.map_or("?".to_owned(), |apex| apex.to_string());
    let line = |a: &srflow_data::micro_expression::Annotation| {
        format!("{}/{} {}-{}-{} {}", a.subject, a.clip, a.onset, apex(a.apex), a.offset, a.class)
    };
    labels.annotations.iter().map(line).collect()
}

fn dropped(labels: &Labels) -> Vec<(&str, DropReason)> {
    labels.dropped.iter().map(|row| (row.clip.as_str(), row.reason)).collect()
}

const CASME3: &str = "Subject,Filename,Onset,Apex,Offset,AU,Objective class,emotion\n\
    spNO.1,e,62,68,96,R12,I,happy\n\
    spNO.1,e,100,106,110,4,III,Others\n\
    spNO.14,J,1012,1019,1038,14,VII,disgust\n\
    spNO.149,d,112,83,358,T28+14,VII,fear\n\
    spNO.40,e,1812,1824,0,18,VII,sad\n\
    spNO.2,a,30,30,40,5,II,surprise\n\
    spNO.2,b,40,38,30,5,II,surprise\n";

#[test]
fn clips_of_casme3_are_excerpts_of_videos_and_repaired() {
    let data = Dataset::new(&[("labels.csv", CASME3)]);
    let labels = data.labels("casme3", "3");
    let expected = [
        "spNO.1/e_62 62-68-96 1",
        "spNO.14/j_1012 1012-1019-1038 0",
        "spNO.149/d_112 112-123-358 0",
        "spNO.40/e_1812 1812-1824-1845 0",
    ];
    assert_eq!(listed(&labels), expected);
    let expected = [
        ("e_100", DropReason::Label),
        ("a_30", DropReason::ApexNotAfterOnset),
        ("b_40", DropReason::FramesOutOfOrder),
    ];
    assert_eq!(dropped(&labels), expected);
    assert_eq!(labels.notes, ["2 rows with wrong frames are repaired"]);

    // The apex that is the onset is spotted, or taken from a list.
    let spots = ClipSource { spots_apexes: true, ..data.source("casme3", "casme3-4") };
    let labels = Labels::read(&spots).unwrap();
    assert_eq!(count_classes(&spots.classes, &labels.annotations), [3, 1, 1, 1]);
    assert!(listed(&labels).contains(&"spNO.2/a_30 30-?-40 2".to_owned()));
    data.write("list/apexes.csv", b"data,subject,clip,apex_frame\ncasme3,spNO.2,a_30,34\ncasme2,1,x,9\n");
    let list = Some(data.path().join("list/apexes.csv"));
    let labels = Labels::read(&ClipSource { apex_list: list, ..data.source("casme3", "3") }).unwrap();
    assert!(listed(&labels).contains(&"spNO.2/a_30 30-34-40 2".to_owned()));

    // Roman numerals.
    let labels = data.labels("casme3", "objective-5");
    assert_eq!(listed(&labels), ["spNO.1/e_62 62-68-96 0", "spNO.1/e_100 100-106-110 2"]);
    let seven = data.labels("casme3", "casme3-7");
    assert_eq!(seven.annotations.iter().map(|a| a.class).collect::<Vec<_>>(), [6, 2, 0, 3, 5]);
}

#[test]
fn frames_of_casme3_lie_in_folders_of_videos() {
    let two_rows = CASME3.lines().take(4).collect::<Vec<_>>().join("\n");
    let data = Dataset::new(&[("labels.csv", &two_rows)]);
    data.frames("part_A/spNO.1/e/color/#.jpg", 60..=120);
    data.frames("part_A/spNO.14/j/color/#.jpg", 1000..=1040);
    let clips = data.open("casme3", "3").clips;
    assert_eq!(clips.iter().map(|clip| clip.frames.len()).collect::<Vec<_>>(), [35, 27]);
}

#[test]
fn part_c_of_casme3_has_commas_and_no_apex() {
    let text = "sub,count,onset,offset,au,emotion\n1,1,373,385,\"R4,5\",negative\n1,2,50,54,\"4，11,\",positive\n2,1,7,9,13?,others\n";
    let data = Dataset::new(&[("c.csv", text)]);
    let labels = data.labels("casme3-c", "casme3-4");
    assert_eq!(listed(&labels), ["01/1 373-?-385 0", "01/2 50-?-54 1", "02/1 7-?-9 3"]);
    let units: Vec<&str> = labels.annotations.iter().map(|a| a.action_units.as_str()).collect();
    assert_eq!(units, ["R4+5", "4+11", "13?"]);
    data.frames("ME_C/01/1/color/#.jpg", 373..=385);
    // Numbered within the clip.
    data.frames("ME_C/01/2/color/#.jpg", 1..=5);
    let clips = data.open("casme3-c", "3").clips;
    assert_eq!(clips[1].frames.keys().copied().collect::<Vec<_>>(), [50, 51, 52, 53, 54]);
    assert!(clips[1].frame(50).unwrap().ends_with("1.jpg"));
}

/// A workbook whose sheets have these rows of cells.
fn workbook(sheets: &[&[&[&str]]]) -> Vec<u8> {
    let mut archive = zip::ZipWriter::new(Cursor::new(Vec::new()));
    let mut part = |name: String, text: String| {
        archive.start_file(name, zip::write::SimpleFileOptions::default()).unwrap();
        archive.write_all(text.as_bytes()).unwrap();
    };
    let numbers = 1..=sheets.len();
    let related = |n: usize| format!(r#"<Relationship Id="r{n}" Target="worksheets/sheet{n}.xml"/>"#);
    let relationships: String = numbers.clone().map(related).collect();
    part("xl/_rels/workbook.xml.rels".to_owned(), format!("<Relationships>{relationships}</Relationships>"));
    let sheet = |n: usize| format!(r#"<sheet name="s{n}" sheetId="{n}" r:id="r{n}"/>"#);
    let listed: String = numbers.map(sheet).collect();
    part("xl/workbook.xml".to_owned(), format!("<workbook><sheets>{listed}</sheets></workbook>"));
    for (number, rows) in sheets.iter().enumerate() {
        let cell = |text: &&str| format!(r#"<c t="inlineStr"><is><t>{text}</t></is></c>"#);
        let row = |cells: &&[&str]| format!("<row>{}</row>", cells.iter().map(cell).collect::<String>());
        let rows: String = rows.iter().map(row).collect();
        part(format!("xl/worksheets/sheet{}.xml", number + 1), format!("<worksheet>{rows}</worksheet>"));
    }
    archive.finish().unwrap().into_inner()
}

#[test]
fn clips_of_casme_squared_are_the_micro_expressions_of_its_videos() {
    let expressions: [&[&str]; 4] = [
        &["1", "anger1_1", "10", "12", "0", "4", "negative", "macro-expression", "anger"],
        &["1", "anger1_2", "20", "24", "30", "4", "negative", "micro-expression", "anger"],
        &["22", "happy2_1", "5", "8", "14", "12", "positive", "micro-expression", "happiness"],
        &["22", "happy2_2", "40", "44", "50", "43", "others", "micro-expression", "happiness"],
    ];
    let folders: [&[&str]; 2] = [&["15", "s15", "1"], &["40", "s40", "22"]];
    let videos: [&[&str]; 2] = [&["0401", "anger1"], &["0503", "happy2"]];
    let data = Dataset::new(&[]);
    data.write("code_final.xlsx", &workbook(&[&expressions, &folders, &videos]));
    let labels = data.labels("casme-squared", "3");
    assert_eq!(listed(&labels), ["s15/0401_2 20-24-30 0", "s40/0503_1 5-8-14 1"]);
    assert_eq!(dropped(&labels), [("0503_2", DropReason::Label)]);
    assert_eq!(labels.notes, ["1 macro-expressions are left out"]);

    data.frames("rawpic/s15/15_0401girlcrashing/img0#.jpg", 18..=32);
    // One folder is misspelt.
    data.frames("rawpic/s40/40_0503unnyfarting/img0#.jpg", 1..=60);
    let found = data.open("casme-squared", "3");
    assert_eq!((found.form, found.clips[1].frames.len()), ("raw", 10));
    data.frames("longVideoFaceCropped/s15/15_0401girlcrashing/img_#.jpg", 18..=32);
    data.frames("longVideoFaceCropped/s40/40_0503funnyfarting/img_#.jpg", 1..=60);
    let both = ClipDataset::open(&data.source("casme-squared", "3"), false).unwrap_err().to_string();
    assert!(both.contains("casme-squared-raw:") && both.contains("casme-squared-cropped:"), "{both}");
    let cropped = data.open("casme-squared-cropped", "3");
    assert!(cropped.clips[0].frame(20).unwrap().ends_with("img_20.jpg"));

    // Videos, whose frames others extract.
    let videos = Dataset::new(&[("rawvideo/s40/40_0503funny.avi", "")]);
    let labels = ClipSource {
        annotations: Some(data.path().join("code_final.xlsx")),
        ..videos.source("casme-squared", "3")
    };
    let places = labels.places(&Labels::read(&labels).unwrap().annotations);
    assert!(places[1].is_file() && !places[0].exists(), "{places:?}");

    let other = Dataset::new(&[]);
    other.write("a.xlsx", &workbook(&[&[&["a", "b"]], &[&["c"]], &[&["d"]]]));
    let error = Labels::read(&other.source("casme-squared", "3")).unwrap_err().to_string();
    assert!(error.contains("code_final.xlsx") && error.contains("holds only a.xlsx"), "{error}");
}

#[test]
fn clips_of_mmew_may_lack_frames_and_be_counted_from_one() {
    let text = "Subject,Filename,OnsetFrame,ApexFrame,OffsetFrame,Action Units,Estimated Emotion,remarks\n\
        1,S1-01,31,36,40,12,happiness,\n1,S1-02,3,5,9,4,others,\n2,S2-01,1,/,/,4,disgust,\n2,S2-02,1,?,9,4,fear,x\n";
    let data = Dataset::new(&[("MMEW.csv", text)]);
    let labels = data.labels("mmew", "mmew-4");
    assert_eq!(listed(&labels), ["1/S1-01 31-36-40 0", "1/S1-02 3-5-9 3"]);
    assert_eq!(dropped(&labels), [("S2-01", DropReason::FramesUnknown), ("S2-02", DropReason::Label)]);
    assert_eq!(dropped(&data.labels("mmew", "3"))[2], ("S2-02", DropReason::ApexUnknown));
    data.frames("Micro_Expression/happiness/S1-01/#.jpg", 1..=10);
    data.frames("Micro_Expression/repression/S1-02/#.jpg", 1..=12);
    let clips = data.open("mmew", "mmew-4").clips;
    assert!(clips[0].frame(36).unwrap().ends_with("6.jpg"), "the sixth of ten frames");
    assert_eq!((clips[1].frames.len(), clips[1].frame(3).unwrap().ends_with("3.jpg")), (7, true));
}

#[test]
fn several_emotions_of_4dme_count_if_they_are_of_one_class() {
    let text = "sub_ID,fold_name,Emotion,Onset,Apex,Offset,AUs,AU4,AU7\n\
        5,5_a,Negative,10,14,20,4+7(k),1,0\n5,5_b,Negative+Repression,1,3,9,4,1,0\n6,6_a,\"Positive, Surprise\",1,3,9,12,0,0\n\
        6,6_b,Negative+Others,1,3,9,4,1,0\n6,6_c,Others,1,3,9,4,1,0\n";
    let data = Dataset::new(&[("micro.csv", text)]);
    let labels = data.labels("4dme", "3");
    assert_eq!(listed(&labels), ["5/5_a 10-14-20 0", "5/5_b 1-3-9 0"]);
    let several = DropReason::SeveralClasses;
    assert_eq!(dropped(&labels), [("6_a", several), ("6_b", several), ("6_c", DropReason::Label)]);
    assert_eq!(listed(&data.labels("4dme", "4dme-5")), ["5/5_a 10-14-20 0", "6/6_c 1-3-9 4"]);
    data.frames("gray_micro/5/5_a/#.jpg", 10..=20);
    data.frames("gray_micro/5/5_b/#.jpg", 1..=9);
    assert_eq!(data.open("4dme", "3").clips.len(), 2);
}

#[test]
fn the_three_spreadsheets_of_dfme_are_read_together() {
    let header = "Subject,Filename,OnsetFrame,ApexFrame,OffsetFrame,Emotion,EmotionId,Fps,AU\n";
    let training = format!("{header}sub0003,sub0003_01,2,5,9,anger,0,500,4+23\n");
    let test = format!("{header}sub0008,sub0008_01,0,3,6,happiness,4,200,12+AD38\n");
    let data = Dataset::new(&[("training_full_with_AU.csv", &training), ("testA_full_with_AU.csv", &test)]);
    let labels = data.labels("dfme", "dfme-7");
    assert_eq!(listed(&labels), ["sub0008/sub0008_01 0-3-6 4", "sub0003/sub0003_01 2-5-9 0"]);
    data.frames("train/sub0003_01/0000#.png", 0..=9);
    data.frames("test_data_A/sub0008_01/0000#.png", 0..=9);
    assert_eq!(data.open("dfme", "3").clips.len(), 2);
    let one = ClipSource {
        annotations: Some(data.path().join("testA_full_with_AU.csv")),
        ..data.source("dfme", "3")
    };
    assert_eq!(Labels::read(&one).unwrap().annotations.len(), 1);
    data.write("testB.csv", test.replace("happiness", "joy").as_bytes());
    let error = Labels::read(&data.source("dfme", "3")).unwrap_err().to_string();
    assert!(error.contains("row 2: Emotion: `joy` is none of DFME's seven"), "{error}");
}

#[test]
fn names_of_frames_of_casme_repeat_the_clip() {
    let text = "Subject,Filename,,OnsetF,ApexF1,ApexF2,OffsetF,,AU,Emotion\n\
        1,EP01_5,,3,6,,9,,4,disgust\n1,EP03_1,,9,6,,5,,4,tense\n2,EP01_8,,2,4,,5,,1+2,surprise\n";
    let data = Dataset::new(&[("casme.csv", text)]);
    let labels = data.labels("casme", "casme-4");
    assert_eq!(listed(&labels), ["01/EP01_5 3-6-9 0", "02/EP01_8 2-4-5 2"]);
    assert_eq!(dropped(&labels), [("EP03_1", DropReason::FramesOutOfOrder)]);
    data.frames("CASME_raw_selected/sub01/EP01_5/EP01_5-#.jpg", 1..=12);
    data.frames("CASME_raw_selected/sub02/EP01_8/EP01_8-00#.jpg", 1..=9);
    let found = data.open("casme", "3");
    assert_eq!((found.form, found.clips.len()), ("raw", 2));
    assert!(found.clips[0].frame(6).unwrap().ends_with("EP01_5-6.jpg"));
    data.frames("Cropped/sub01/EP01_5/reg_EP01_5-#.jpg", 3..=9);
    data.frames("Cropped/sub02/EP01_8/reg_EP01_8-#.jpg", 2..=5);
    assert_eq!(data.open("casme-cropped", "3").clips.len(), 2);
}

#[test]
fn smic_vis_and_nir_have_their_own_spreadsheets() {
    let header = "Subject,Filename,,OnsetF,OffsetF,,FirstF,LastF,Emotion\n";
    let vis = format!(
        "{header}1,s1_ne_01,,230,238,,200,260,negative\n11,s11_sur_02,,40,44,,30,60,surprise\n,,,,,,,,\nNote,frames are counted from 1,,,,,,,\n"
    );
    let nir = format!("{header}1,s1_ne_01,,330,338,,300,360,negative\n");
    let data =
        Dataset::new(&[("SMIC-VIS-E_annotation.csv", &vis), ("NIR_long/SMIC-NIR-E_annotation.csv", &nir)]);
    assert_eq!(listed(&data.labels("smic-vis", "3")), ["01/s1_ne_01 230-?-238 0", "11/s11_sur_02 40-?-44 2"]);
    let nir = data.labels("smic-nir", "megc2019");
    assert_eq!((nir.dataset.as_str(), &listed(&nir)[0]), ("smic-nir", &"01/s1_ne_01 330-?-338 0".to_owned()));
    data.frames("VIS_long/SMIC-VIS-E/VIS/s01/s1_ne_01/image 000#.jpg", 200..=260);
    data.frames("VIS_long/SMIC-VIS-E/VIS/s11/s11_sur_02/image 0000#.jpg", 30..=60);
    let found = data.open("smic-vis", "3");
    assert_eq!((found.form, found.clips[0].frames.len()), ("extended", 9));
    let error = ClipDataset::open(&data.source("smic-nir", "3"), false).unwrap_err().to_string();
    assert!(error.contains("Give the folder that contains NIR_long or NIR"), "{error}");
}

/// Records of an old Excel workbook: type and content.
fn records(records: &[(u16, Vec<u8>)]) -> Vec<u8> {
    let record = |(kind, content): &(u16, Vec<u8>)| {
        [&kind.to_le_bytes()[..], &u16::try_from(content.len()).unwrap().to_le_bytes(), content].concat()
    };
    records.iter().flat_map(record).collect()
}

/// An old Excel workbook with one sheet of these rows, all texts.
fn old_workbook(rows: &[&[&str]]) -> Vec<u8> {
    let (begin, end) = ((0x809, vec![0, 6]), (0x00a, Vec::new()));
    let cell = |row: usize, column: usize, text: &str| {
        let place = [row, column, 0, text.len()].map(|number| u16::try_from(number).unwrap().to_le_bytes());
        (0x204, [place.as_flattened(), &[0], text.as_bytes()].concat())
    };
    let mut sheet = vec![begin.clone()];
    for (row, cells) in rows.iter().enumerate() {
        sheet.extend(cells.iter().enumerate().map(|(column, text)| cell(row, column, text)));
    }
    sheet.push(end.clone());
    let listed = |at: u32| (0x085, [&at.to_le_bytes()[..], &[0, 0]].concat());
    let globals = |at| records(&[begin.clone(), listed(at), end.clone()]);
    let at = u32::try_from(globals(0).len()).unwrap();
    let mut file = cfb::CompoundFile::create(Cursor::new(Vec::new())).unwrap();
    let stream = [globals(at), records(&sheet)].concat();
    file.create_stream("/Workbook").unwrap().write_all(&stream).unwrap();
    file.flush().unwrap();
    file.into_inner().into_inner()
}

/// CAS(ME)³ is published as `.xls`.
#[test]
fn old_excel_workbooks_are_read() {
    let rows: Vec<Vec<&str>> = CASME3.lines().map(|line| line.split(',').collect()).collect();
    let rows: Vec<&[&str]> = rows.iter().map(Vec::as_slice).collect();
    let (old, csv) = (Dataset::new(&[]), Dataset::new(&[("labels.csv", CASME3)]));
    old.write("labels.xls", &old_workbook(&rows));
    let (old_labels, labels) = (old.labels("casme3", "3"), csv.labels("casme3", "3"));
    assert_eq!((old_labels.annotations, old_labels.dropped), (labels.annotations, labels.dropped));
    // Whatever its name ends in.
    fs::rename(old.path().join("labels.xls"), old.path().join("labels.xlsx")).unwrap();
    assert_eq!(old.labels("casme3", "3").annotations.len(), 4);

    let header = ["Subject", "Filename", "Onset", "Apex", "Offset", "AU", "Expression type"];
    let row = ["spNO.1", "a", "37", "63", "65", "4", "Macro-expression"];
    old.write("long.xls", &old_workbook(&[&header, &row]));
    let Ok(long) = format!("casme3:{}", old.path().join("long.xls").display()).parse::<IntervalSource>();
    assert_eq!(long.read().unwrap().intervals[0].video, "spNO.1_a");
}
