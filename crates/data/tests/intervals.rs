//! Intervals of expressions are read as published, repaired where the files are known to need it, and refused with the row.

use std::fs;
use std::path::Path;

use srflow_data::micro_expression::intervals::{
    ExpressionKind, Interval, IntervalSource, Intervals, write_intervals,
};

fn read(source: &str) -> Result<Intervals, String> {
    let Ok(source) = source.parse::<IntervalSource>();
    source.read().map_err(|error| error.to_string())
}

fn spans(intervals: &[Interval]) -> Vec<(&str, ExpressionKind, i64, Option<i64>, i64)> {
    intervals.iter().map(|i| (i.video.as_str(), i.kind, i.onset, i.apex, i.offset)).collect()
}

const MICRO: ExpressionKind = ExpressionKind::Micro;
const MACRO: ExpressionKind = ExpressionKind::Macro;

#[test]
fn lists_are_read_in_their_usual_forms() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("list.csv");
    let path = file.display().to_string();
    for text in [
        "video,type,onset,apex,offset\na,micro,3,5,9\nb,macro,-2,,40\n",
        "\u{feff}Vid;Onset;Apex;Offset;Type\r\na;3.0;5.0;9.0;ME\r\nb;-2;;40;mae\r\n",
        "vid,pred_onset,pred_apex,pred_offset,type\na,3,5,9,Micro - 1/2\nb,-2,,40,macro-expression\n",
    ] {
        fs::write(&file, text).unwrap();
        let found = read(&path).unwrap();
        assert_eq!(spans(&found.intervals), [("a", MICRO, 3, Some(5), 9), ("b", MACRO, -2, None, 40)]);
        // Written and read back.
        let copy = folder.path().join("copy.csv");
        write_intervals(&copy, &found.intervals).unwrap();
        assert_eq!(read(&format!("csv:{}", copy.display())).unwrap(), found);
    }
    for (text, reason) in [
        ("video,onset,offset\na,1,2\n", "type is not among the columns video, onset, offset"),
        (
            "video,onset,offset,type\na,9,3,micro\n",
            "row 2: expected onset <= offset, found onset 9, offset 3",
        ),
        ("video,onset,offset,type\na,1,2,smile\n", "row 2: type: expected micro or macro"),
        ("video,onset,offset,type\na,1.5,2,micro\n", "row 2: onset: expected a frame number, found `1.5`"),
        ("video,onset,offset,type\n,1,2,micro\n", "row 2: video"),
        ("video,onset,offset,type\na,1,99999999999999999999,micro\n", "row 2: offset"),
    ] {
        fs::write(&file, text).unwrap();
        let error = read(&path).unwrap_err();
        assert!(error.contains(reason), "{error}");
    }
}

#[test]
fn fractions_and_unknown_frames_of_samm_are_repaired() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("samm.csv");
    let text = "Subject,Filename,Inducement Code,Onset,Apex,Offset,Duration,Type,Action Units,Notes\n\
        006,006_1_1,1,566.4000000000001,647.6,743.1999999999998,177.8,Macro,4(B/C)+7B,\n\
        006,006_1_2,1,3562,-1,3632,71,Micro - 1/2,4+7,\n\
        011,011_6_10,6,0,3322.9999999999995,4123.4,4124.4,Macro,6C,\n";
    fs::write(&file, text).unwrap();
    let found = read(&format!("samm-long:{}", file.display())).unwrap();
    let expected = [
        ("006_1", MACRO, 566, Some(648), 743),
        ("006_1", MICRO, 3562, None, 3632),
        ("011_6", MACRO, 1, Some(3323), 4123),
    ];
    assert_eq!(spans(&found.intervals), expected);
    assert_eq!(found.fps, Some(200.0));
    assert!(found.notes[0].contains("1 expressions began before the video"), "{:?}", found.notes);
}

#[test]
fn casme3_is_read_whatever_the_case_of_its_letters() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("casme3.csv");
    let text = "Subject,Filename,Onset,Apex,Offset,AU,Expression type,Objective class\n\
        spNO.14,J,1012,1019,1038,14,Micro-expression,VII\nspNO.1,a,37,63,65,4+15,Macro-expression,VII\n";
    fs::write(&file, text).unwrap();
    let found = read(&format!("casme3:{}", file.display())).unwrap();
    let expected = [("spNO.14_j", MICRO, 1012, Some(1019), 1038), ("spNO.1_a", MACRO, 37, Some(63), 65)];
    assert_eq!(spans(&found.intervals), expected);
}

#[test]
fn a_table_of_another_dataset_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("other.csv");
    fs::write(&file, "Subject,Filename,Onset,Apex,Offset,AU,Expression type\na,b,1,2,3,4,Micro\n").unwrap();
    let error = read(&format!("samm-long:{}", file.display())).unwrap_err();
    assert!(error.contains("these are those of the expressions of CAS(ME)³"), "{error}");
    let error = read(&format!("casme-squared:{}", file.display())).unwrap_err();
    assert!(error.contains("sheets of expressions, folders and videos"), "{error}");
    assert!(read(&Path::new("nowhere").join("x.csv").display().to_string()).is_err());
}

/// A workbook whose sheets have these rows of cells.
fn workbook(path: &Path, sheets: &[&[&[&str]]]) {
    let mut archive = zip::ZipWriter::new(fs::File::create(path).unwrap());
    let mut part = |name: String, text: String| {
        archive.start_file(name, zip::write::SimpleFileOptions::default()).unwrap();
        std::io::Write::write_all(&mut archive, text.as_bytes()).unwrap();
    };
    let numbers = 1..=sheets.len();
    let related = |n: usize| format!(r#"<Relationship Id="r{n}" Target="worksheets/sheet{n}.xml"/>"#);
    let relationships: String = numbers.clone().map(related).collect();
    part("xl/_rels/workbook.xml.rels".to_owned(), format!("<Relationships>{relationships}</Relationships>"));
    let listed: String =
        numbers.map(|n| format!(r#"<sheet name="s{n}" sheetId="{n}" r:id="r{n}"/>"#)).collect();
    part(
        "xl/workbook.xml".to_owned(),
        format!(r#"<workbook xmlns:r="x"><sheets>{listed}</sheets></workbook>"#),
    );
    for (number, rows) in sheets.iter().enumerate() {
        let cell = |text: &&str| format!(r#"<c t="inlineStr"><is><t>{text}</t></is></c>"#);
        let row = |cells: &&[&str]| format!("<row>{}</row>", cells.iter().map(cell).collect::<String>());
        let rows: String = rows.iter().map(row).collect();
        part(format!("xl/worksheets/sheet{}.xml", number + 1), format!("<worksheet>{rows}</worksheet>"));
    }
    archive.finish().unwrap();
}

#[test]
fn expressions_of_casme_squared_are_named_by_their_videos() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("code_final.xlsx");
    let expressions: [&[&str]; 4] = [
        &["1", "anger1_1", "557", "572", "608", "4+10+14", "negative", "macro-expression", "anger"],
        &["1", "anger2_1", "2155", "2163", "0", "4", "negative", "macro-expression", "anger"],
        &["22", "disgust2_3", "699", "0", "707", "43", "others", "micro-expression", "disgust"],
        &["22", "disgust2_4", "1221", "1230", "1224", "4", "negative", "macro-expression", "disgust"],
    ];
    let folders: [&[&str]; 2] = [&["15", "s15", "1"], &["40", "s40", "22"]];
    let videos: [&[&str]; 3] = [&["0401", "anger1"], &["0402", "anger2"], &["0102", "disgust2"]];
    workbook(&file, &[&expressions, &folders, &videos]);
    let source = format!("casme-squared:{}", file.display());
    let found = read(&source).unwrap();
    let expected = [
        ("s15_0401", MACRO, 557, Some(572), 608),
        ("s15_0402", MACRO, 2155, Some(2163), 2163),
        ("s40_0102", MICRO, 699, None, 707),
        ("s40_0102", MACRO, 1221, Some(1230), 1224),
    ];
    assert_eq!(spans(&found.intervals), expected);
    assert_eq!((found.fps, found.notes.len()), (Some(30.0), 2));

    workbook(&file, &[&expressions, &folders[..1], &videos]);
    let error = read(&source).unwrap_err();
    assert!(error.contains("row 3: subject 22 has no row in the second sheet"), "{error}");
}
