//! Excel workbooks (`.xlsx`: ECMA-376, part 1, section 18): only the text of the cells of every sheet.
//!
//! Whatever a file claims, no more than [`MAX_INFLATED`] is inflated, and no more than a [`Budget`] is kept.
//!
//! Not calamine: it reserves what a sheet claims, makes every sheet a full rectangle, and inflates without a limit.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{Cursor, Read};

use quick_xml::Reader;
use quick_xml::XmlVersion;
use quick_xml::escape::resolve_predefined_entity;
use quick_xml::events::{BytesStart, Event};
use zip::ZipArchive;
use zip::result::ZipError;

use super::cells::{Budget, Cells, MAX_SHEETS, number_text};

/// Limit on what the parts of a workbook inflate to. Those of the published ones inflate to 0.4 MB.
const MAX_INFLATED: u64 = 32 << 20;

/// The cells of every worksheet, in workbook order.
///
/// # Errors
/// What is wrong, without the file name.
pub(super) fn read_workbook(bytes: Vec<u8>) -> Result<Vec<Cells>, String> {
    let mut workbook = Workbook {
        archive: srflow_files::open_zip(bytes).map_err(|error| error.to_string())?,
        inflatable: MAX_INFLATED,
    };
    let mut left = Budget::WHOLE;
    let targets = relationships(&workbook.needed("xl/_rels/workbook.xml.rels")?)?;
    let sheets = sheet_relationships(&workbook.needed("xl/workbook.xml")?)?;
    let strings = workbook.part("xl/sharedStrings.xml")?;
    let strings = strings.map_or(Ok(Vec::new()), |text| shared_strings(&text))?;
    let mut read = BTreeSet::new();
    let mut found = Vec::new();
    for sheet in sheets {
        let target = targets.get(&sheet).ok_or("a sheet without its part")?;
        let name = match target.strip_prefix('/') {
            Some(whole) => whole.to_owned(),
            None => format!("xl/{target}"),
        };
        if !read.insert(name.clone()) {
            return Err(format!("two sheets are the same part {name}"));
        }
        if !name.contains("worksheets/") {
            continue; // a chart
        }
        let text = workbook.needed(&name)?;
        found.push(cells(&text, &strings, &mut left)?);
    }
    Ok(found)
}

struct Workbook {
    archive: ZipArchive<Cursor<Vec<u8>>>,
    /// How much may still be inflated.
    inflatable: u64,
}

impl Workbook {
    /// The text of a part, if present.
    fn part(&mut self, name: &str) -> Result<Option<String>, String> {
        let entry = match self.archive.by_name(name) {
            Ok(entry) => entry,
            Err(ZipError::FileNotFound) => return Ok(None),
            Err(error) => return Err(format!("{name}: {error}")),
        };
        let mut bytes = Vec::new();
        // The directory's size is only a claim: the output is counted.
        let count = entry.take(self.inflatable + 1).read_to_end(&mut bytes);
        let count = count.map_err(|error| format!("{name}: {error}"))? as u64;
        self.inflatable = self
            .inflatable
            .checked_sub(count)
            .ok_or_else(|| format!("its parts inflate to more than {} MiB", MAX_INFLATED >> 20))?;
        let text = String::from_utf8(bytes).map_err(|_| format!("{name}: expected UTF-8"))?;
        Ok(Some(text))
    }

    fn needed(&mut self, name: &str) -> Result<String, String> {
        self.part(name)?.ok_or_else(|| format!("it has no {name}"))
    }
}

type Xml<'a> = Reader<&'a [u8]>;

fn next<'a>(xml: &mut Xml<'a>) -> Result<Event<'a>, String> {
    xml.read_event().map_err(|error| error.to_string())
}

fn attribute(tag: &BytesStart, is_name: impl Fn(&str) -> bool) -> Result<Option<String>, String> {
    for attribute in tag.attributes().with_checks(false) {
        let attribute = attribute.map_err(|error| error.to_string())?;
        if is_name(attribute.key.local_name().as_ref()) {
            let value = attribute.normalized_value(XmlVersion::Implicit1_0);
            return value.map(|value| Some(value.into_owned())).map_err(|error| error.to_string());
        }
    }
    Ok(None)
}

/// Calls `on_tag` with each tag of this name, and whether it is empty.
fn each_tag<'a>(
    text: &'a str,
    name: &str,
    mut on_tag: impl FnMut(&mut Xml<'a>, BytesStart<'a>, bool) -> Result<(), String>,
) -> Result<(), String> {
    let mut xml = Reader::from_str(text);
    loop {
        match next(&mut xml)? {
            Event::Start(tag) if tag.local_name().as_ref() == name => on_tag(&mut xml, tag, false)?,
            Event::Empty(tag) if tag.local_name().as_ref() == name => on_tag(&mut xml, tag, true)?,
            Event::Eof => return Ok(()),
            _ => {}
        }
    }
}

/// Targets of the relationships, by id.
fn relationships(text: &str) -> Result<BTreeMap<String, String>, String> {
    let mut targets = BTreeMap::new();
    each_tag(text, "Relationship", |_, tag, _| {
        let id = attribute(&tag, |name| name == "Id")?;
        targets.extend(id.zip(attribute(&tag, |name| name == "Target")?));
        Ok(())
    })?;
    Ok(targets)
}

/// The relationships of the sheets, in order.
fn sheet_relationships(text: &str) -> Result<Vec<String>, String> {
    let mut sheets = Vec::new();
    each_tag(text, "sheet", |_, tag, _| {
        if sheets.len() == MAX_SHEETS {
            return Err(format!("more than {MAX_SHEETS} sheets"));
        }
        sheets.push(attribute(&tag, |name| name == "id")?.ok_or("a sheet without its part")?);
        Ok(())
    })?;
    Ok(sheets)
}

/// The shared strings. The counts that the table claims are ignored.
fn shared_strings(text: &str) -> Result<Vec<String>, String> {
    let mut strings = Vec::new();
    each_tag(text, "si", |xml, _, is_empty| {
        strings.push(if is_empty { String::new() } else { rich_text(xml, "si")? });
        Ok(())
    })?;
    Ok(strings)
}

/// The runs of text up to the end of `element`, without phonetic text.
fn rich_text(xml: &mut Xml, element: &str) -> Result<String, String> {
    let mut text = String::new();
    let mut pronunciation = false;
    loop {
        match next(xml)? {
            Event::Start(tag) if tag.local_name().as_ref() == "rPh" => pronunciation = true,
            Event::End(tag) if tag.local_name().as_ref() == "rPh" => pronunciation = false,
            Event::Start(tag) if tag.local_name().as_ref() == "t" => {
                let preserve = attribute(&tag, |name| name == "space")?.as_deref() == Some("preserve");
                let run = plain_text(xml, "t")?;
                let run = if preserve { &run } else { run.trim_matches([' ', '\t', '\r', '\n']) };
                if !pronunciation {
                    text.push_str(run);
                }
            }
            Event::End(tag) if tag.local_name().as_ref() == element => return Ok(text),
            Event::Eof => return Err(format!("truncated in <{element}>")),
            _ => {}
        }
    }
}

/// The text up to the end of `element`.
fn plain_text(xml: &mut Xml, element: &str) -> Result<String, String> {
    let mut text = String::new();
    loop {
        match next(xml)? {
            Event::Text(part) => text.push_str(&part.xml10_content()),
            Event::CData(part) => text.push_str(&part.xml10_content()),
            Event::GeneralRef(entity) => {
                match entity.resolve_char_ref().map_err(|error| error.to_string())? {
                    Some(c) => text.push(c),
                    None => {
                        let known = resolve_predefined_entity(&entity.xml10_content());
                        text.push_str(known.ok_or("an unknown entity")?);
                    }
                }
            }
            Event::End(tag) if tag.local_name().as_ref() == element => return Ok(text),
            Event::Eof => return Err(format!("truncated in <{element}>")),
            _ => {}
        }
    }
}

/// The cells of a sheet that hold any text.
fn cells(text: &str, strings: &[String], left: &mut Budget) -> Result<Cells, String> {
    let mut xml = Reader::from_str(text);
    let mut cells = Cells::new();
    let (mut row, mut column) = (0_u32, 0_u32); // of the next cell, unless it has a reference
    loop {
        match next(&mut xml)? {
            Event::Start(tag) if tag.local_name().as_ref() == "row" => {
                if let Some(number) = attribute(&tag, |name| name == "r")? {
                    let number = number.parse::<u32>().ok().filter(|number| *number > 0);
                    row = number.ok_or("a row with an invalid number")? - 1;
                }
                column = 0;
            }
            Event::End(tag) if tag.local_name().as_ref() == "row" => row = row.saturating_add(1),
            Event::Start(tag) if tag.local_name().as_ref() == "c" => {
                (row, column) = place(&tag)?.unwrap_or((row, column));
                let text = cell_text(&mut xml, &tag, strings)?;
                left.keep(&mut cells, (row, column), &text)?;
                column = column.saturating_add(1);
            }
            Event::Empty(tag) if tag.local_name().as_ref() == "c" => {
                (row, column) = place(&tag)?.unwrap_or((row, column));
                column = column.saturating_add(1);
            }
            Event::Eof => return Ok(cells),
            _ => {}
        }
    }
}

/// Row and column of a cell, where it says them.
fn place(cell: &BytesStart) -> Result<Option<(u32, u32)>, String> {
    let Some(reference) = attribute(cell, |name| name == "r")? else { return Ok(None) };
    let found = position(&reference);
    found.map(Some).ok_or_else(|| format!("a cell at `{}`", srflow_core::excerpt(&reference)))
}

/// Row and column, from 0, of a reference such as `AB12`.
fn position(reference: &str) -> Option<(u32, u32)> {
    let letters = reference.find(|c: char| !c.is_ascii_uppercase())?;
    let (column, row) = reference.split_at(letters);
    let digit = |number: u32, letter: u8| number.checked_mul(26)?.checked_add(u32::from(letter - b'A') + 1);
    let column = column.bytes().try_fold(0, digit)?.checked_sub(1)?;
    Some((row.parse::<u32>().ok()?.checked_sub(1)?, column))
}

/// The text of a cell as displayed, but without number formats: numbers in their shortest form.
fn cell_text(xml: &mut Xml, tag: &BytesStart, strings: &[String]) -> Result<String, String> {
    let kind = attribute(tag, |name| name == "t")?;
    let (mut value, mut inline) = (None, None);
    loop {
        match next(xml)? {
            Event::Start(tag) => match tag.local_name().as_ref() {
                "v" => value = Some(plain_text(xml, "v")?),
                "is" => inline = Some(rich_text(xml, "is")?),
                _ => {}
            },
            Event::End(tag) if tag.local_name().as_ref() == "c" => break,
            Event::Eof => return Err("truncated in a cell".into()),
            _ => {}
        }
    }
    let value = value.unwrap_or_default();
    Ok(match kind.as_deref() {
        Some("inlineStr") => inline.unwrap_or_default(),
        Some("s") if value.is_empty() => value,
        Some("s") => {
            let string = value.trim().parse().ok().and_then(|number: usize| strings.get(number));
            string.ok_or("a cell refers to a missing shared string")?.clone()
        }
        Some("b") => (value != "0").to_string(),
        Some("e") => String::new(),
        Some("str" | "d") => value,
        Some("n") | None => value.parse::<f64>().map_or(value, number_text),
        Some(other) => return Err(format!("a cell of the unknown type `{}`", srflow_core::excerpt(other))),
    })
}

#[cfg(test)]
mod tests {
    use std::io::Write as _;

    use zip::write::SimpleFileOptions;

    use super::*;

    const RELATIONSHIPS: &str =
        r#"<Relationships><Relationship Id="r1" Target="worksheets/sheet1.xml"/></Relationships>"#;
    const WORKBOOK: &str =
        r#"<workbook xmlns:r="x"><sheets><sheet name="a" sheetId="1" r:id="r1"/></sheets></workbook>"#;

    /// A workbook with these strings and this sheet; `parts` override others.
    fn workbook(parts: &[(&str, &str)]) -> Vec<u8> {
        let mut archive = zip::ZipWriter::new(Cursor::new(Vec::new()));
        let standard = [("xl/_rels/workbook.xml.rels", RELATIONSHIPS), ("xl/workbook.xml", WORKBOOK)];
        let given = |name: &str| parts.iter().any(|(part, _)| *part == name);
        for (name, text) in standard.iter().filter(|(name, _)| !given(name)).chain(parts) {
            archive.start_file(*name, SimpleFileOptions::default()).unwrap();
            archive.write_all(text.as_bytes()).unwrap();
        }
        archive.finish().unwrap().into_inner()
    }

    const STRINGS: &str = "xl/sharedStrings.xml";
    const SHEET: &str = "xl/worksheets/sheet1.xml";

    #[test]
    fn cells_of_every_kind_are_read() {
        let strings = r#"<sst><si><t> a &amp; b&#x21;</t></si><si><r><t>ri</t></r><r><t xml:space="preserve">ch </t></r><rPh><t>no</t></rPh></si><si/></sst>"#;
        let sheet = r#"<worksheet><sheetData><row r="2"><c r="A2" t="s"><v>0</v></c><c t="s"><v>1</v></c>
            <c r="AB2"><v>12.0</v></c><c r="AC2" t="str"><f>1+1</f><v>x&lt;y</v></c></row>
            <row><c t="inlineStr"><is><t>in</t></is></c><c t="b"><v>1</v></c><c t="e"><v>#N/A</v></c><c/><c><v>0.1</v></c>
            <c r="A200001"><v>9</v></c></row></sheetData></worksheet>"#;
        let sheets = read_workbook(workbook(&[(STRINGS, strings), (SHEET, sheet)])).unwrap();
        let text = |pairs: &[(u32, &str)]| pairs.iter().map(|(at, text)| (*at, (*text).to_owned())).collect();
        let expected = [
            (1, text(&[(0, "a & b!"), (1, "rich "), (27, "12"), (28, "x<y")])),
            (2, text(&[(0, "in"), (1, "true"), (4, "0.1")])),
        ];
        assert_eq!(sheets, [Cells::from(expected)]);
    }

    fn refused(parts: &[(&str, &str)]) -> String {
        let bytes = workbook(parts);
        assert!(bytes.len() < 1_000_000, "a small file");
        read_workbook(bytes).unwrap_err()
    }

    #[test]
    fn claimed_counts_take_no_memory() {
        for count in ["18446744073709551615", "4000000000"] {
            let strings = format!(r#"<sst count="{count}" uniqueCount="{count}"><si><t>a</t></si></sst>"#);
            let sheet =
                r#"<worksheet><dimension ref="A1:XFD1048576"/><row><c t="s"><v>0</v></c></row></worksheet>"#;
            let sheets = read_workbook(workbook(&[(STRINGS, &strings), (SHEET, sheet)])).unwrap();
            assert_eq!(sheets[0][&0][&0], "a");
        }
    }

    #[test]
    fn decompression_bombs_are_refused() {
        let items = format!("<sst>{}</sst>", "<si/>".repeat(8 << 20));
        assert!(
            refused(&[(STRINGS, &items), (SHEET, "<worksheet/>")]).contains("inflate to more than 32 MiB")
        );
        let row = format!("<row>{}</row>", "<c><v>1</v></c>".repeat(250));
        let cells = format!("<worksheet>{}</worksheet>", row.repeat(2_500));
        assert!(refused(&[(SHEET, &cells)]).contains("more than 500000 cells"));
        let strings = format!("<sst><si><t>{}</t></si></sst>", "x".repeat(1 << 20));
        let cells = "<c t=\"s\"><v>0</v></c>".repeat(100);
        let sheet = format!("<worksheet><row>{cells}</row></worksheet>");
        assert!(refused(&[(STRINGS, &strings), (SHEET, &sheet)]).contains("32 MiB of text"));
        let sheets = r#"<sheet id="r1"/>"#.repeat(1000);
        assert!(refused(&[("xl/workbook.xml", &sheets)]).contains("more than 64 sheets"));
        let twice = r#"<sheet id="r1"/><sheet id="r1"/>"#;
        assert!(refused(&[("xl/workbook.xml", twice), (SHEET, "<worksheet/>")]).contains("same part"));
    }
}
