//! Workbooks of Excel 97 to 2003 (`.xls`: \[MS-XLS\], records of BIFF8 in a compound file): only the text of the cells of every sheet.
//!
//! Every record is compared with the bytes that are there; what sheets claim to hold is not read. No more than a [`Budget`] is kept. Not
//! calamine: it makes every sheet a full rectangle (one cell in the last row and column takes gigabytes), reserves what a sheet claims,
//! and slices records without a check.

use std::collections::BTreeSet;
use std::io::{Cursor, Read as _};

use super::cells::{Budget, Cells, MAX_SHEETS, number_text};

const BIFF8: u16 = 0x0600;
/// The longest stream that is read: no longer than the longest file.
const MAX_STREAM: u64 = 16 << 20;

/// Types of records.
mod kind {
    pub const FORMULA: u16 = 0x0006;
    pub const EOF: u16 = 0x000A;
    pub const FILE_PASS: u16 = 0x002F;
    pub const CONTINUE: u16 = 0x003C;
    pub const BOUND_SHEET: u16 = 0x0085;
    pub const MUL_RK: u16 = 0x00BD;
    pub const R_STRING: u16 = 0x00D6;
    pub const SST: u16 = 0x00FC;
    pub const LABEL_SST: u16 = 0x00FD;
    pub const NUMBER: u16 = 0x0203;
    pub const LABEL: u16 = 0x0204;
    pub const BOOL_ERR: u16 = 0x0205;
    pub const STRING: u16 = 0x0207;
    pub const RK: u16 = 0x027E;
    pub const BOF: u16 = 0x0809;
}

/// The cells of every worksheet, in workbook order.
///
/// # Errors
/// What is wrong, without the file name.
pub fn read_workbook(bytes: Vec<u8>) -> Result<Vec<Cells>, String> {
    let mut file = cfb::CompoundFile::open(Cursor::new(bytes)).map_err(|error| error.to_string())?;
    if file.exists("/EncryptedPackage") {
        return Err("it is encrypted: save it without a password".into());
    }
    let mut stream = Vec::new();
    let workbook = file.open_stream("/Workbook");
    let workbook = workbook.map_err(|_| "it has no stream `Workbook`: save it as .xlsx".to_owned())?;
    workbook.take(MAX_STREAM).read_to_end(&mut stream).map_err(|error| error.to_string())?;

    let Globals { sheets, strings } = globals(&stream)?;
    let mut left = Budget::WHOLE;
    let mut seen = BTreeSet::new();
    let mut found = Vec::new();
    for at in sheets {
        if !seen.insert(at) {
            return Err(format!("two sheets begin at byte {at}"));
        }
        let sheet = stream.get(at..).ok_or_else(|| format!("a sheet begins at byte {at}, behind the end"))?;
        found.push(cells(sheet, &strings, &mut left)?);
    }
    Ok(found)
}

/// The records of a stream: type and content.
struct Records<'a>(&'a [u8]);

impl<'a> Records<'a> {
    fn next(&mut self) -> Result<Option<(u16, &'a [u8])>, String> {
        // Writers pad streams.
        if self.0.len() < 4 {
            return Ok(None);
        }
        let mut head = Fields(self.0);
        let (kind, length) = (head.u16()?, usize::from(head.u16()?));
        let content = head.0.get(..length).ok_or("truncated in a record")?;
        self.0 = &head.0[length..];
        Ok(Some((kind, content)))
    }

    fn next_if(&mut self, wanted: u16) -> Result<Option<&'a [u8]>, String> {
        let mut ahead = Self(self.0);
        match ahead.next()? {
            Some((kind, content)) if kind == wanted => {
                *self = ahead;
                Ok(Some(content))
            }
            _ => Ok(None),
        }
    }
}

/// The fields of a record.
struct Fields<'a>(&'a [u8]);

impl<'a> Fields<'a> {
    fn bytes(&mut self, count: usize) -> Result<&'a [u8], String> {
        let (taken, rest) = self.0.split_at_checked(count).ok_or("a record is too short")?;
        self.0 = rest;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], String> {
        let (taken, rest) = self.0.split_first_chunk().ok_or("a record is too short")?;
        self.0 = rest;
        Ok(*taken)
    }

    fn u8(&mut self) -> Result<u8, String> {
        self.array::<1>().map(|[byte]| byte)
    }

    fn u16(&mut self) -> Result<u16, String> {
        self.array().map(u16::from_le_bytes)
    }

    fn u32(&mut self) -> Result<u32, String> {
        self.array().map(u32::from_le_bytes)
    }

    fn f64(&mut self) -> Result<f64, String> {
        self.array().map(f64::from_le_bytes)
    }

    /// Row and column of a cell.
    fn place(&mut self) -> Result<(u32, u32), String> {
        Ok((self.u16()?.into(), self.u16()?.into()))
    }

    /// A text of its own, not in the table of shared ones.
    fn text(&mut self) -> Result<String, String> {
        let (length, wide) = (usize::from(self.u16()?), self.u8()? & 1 != 0);
        let bytes = self.bytes(if wide { 2 * length } else { length })?;
        let mut units = Vec::new();
        push_units(&mut units, bytes, wide);
        Ok(String::from_utf16_lossy(&units))
    }
}

/// Letters of one byte are those of Unicode's first 256.
fn push_units(units: &mut Vec<u16>, bytes: &[u8], wide: bool) {
    match wide {
        true => units.extend(bytes.as_chunks().0.iter().map(|unit| u16::from_le_bytes(*unit))),
        false => units.extend(bytes.iter().map(|byte| u16::from(*byte))),
    }
}

/// What sheets share.
struct Globals {
    /// Where the worksheets begin in the stream.
    sheets: Vec<usize>,
    strings: Vec<String>,
}

fn globals(stream: &[u8]) -> Result<Globals, String> {
    let mut records = Records(stream);
    let (mut sheets, mut strings) = (Vec::new(), Vec::new());
    match records.next()? {
        Some((kind::BOF, content)) if Fields(content).u16()? == BIFF8 => {}
        _ => return Err("it is older than Excel 97: save it as .xlsx".into()),
    }
    while let Some((kind, content)) = records.next()? {
        match kind {
            kind::FILE_PASS => return Err("it is encrypted: save it without a password".into()),
            kind::BOUND_SHEET => {
                let mut fields = Fields(content);
                let (at, _visible, kind) = (fields.u32()?, fields.u8()?, fields.u8()?);
                if sheets.len() == MAX_SHEETS {
                    return Err(format!("more than {MAX_SHEETS} sheets"));
                }
                // The others are charts and macros.
                if kind == 0 {
                    sheets.push(at as usize);
                }
            }
            kind::SST => {
                let mut parts = vec![content];
                while let Some(more) = records.next_if(kind::CONTINUE)? {
                    parts.push(more);
                }
                strings = shared_strings(&parts)?;
            }
            kind::EOF => return Ok(Globals { sheets, strings }),
            _ => {}
        }
    }
    Err("truncated before its sheets".into())
}

/// The shared strings, in a record and those that continue it. The counts that the table claims are ignored.
fn shared_strings(parts: &[&[u8]]) -> Result<Vec<String>, String> {
    let mut parts = Parts { current: Fields(&[]), rest: parts };
    parts.skip(8)?;
    let mut strings = Vec::new();
    while parts.more() {
        let (length, flags) = (parts.current.u16()?, parts.current.u8()?);
        let runs = if flags & 8 != 0 { parts.current.u16()? } else { 0 };
        let phonetic = if flags & 4 != 0 { parts.current.u32()? } else { 0 };
        strings.push(parts.text(length.into(), flags & 1 != 0)?);
        parts.skip(4 * usize::from(runs))?;
        parts.skip(phonetic as usize)?;
    }
    Ok(strings)
}

/// A record and those that continue it.
struct Parts<'a> {
    current: Fields<'a>,
    rest: &'a [&'a [u8]],
}

impl Parts<'_> {
    /// Whether any byte is left; goes on to the record that holds it.
    fn more(&mut self) -> bool {
        while self.current.0.is_empty() {
            let Some((next, rest)) = self.rest.split_first() else { return false };
            (self.current, self.rest) = (Fields(next), rest);
        }
        true
    }

    fn skip(&mut self, mut count: usize) -> Result<(), String> {
        while count > 0 {
            if !self.more() {
                return Err("truncated in the shared strings".into());
            }
            count -= self.current.bytes(count.min(self.current.0.len()))?.len();
        }
        Ok(())
    }

    /// Letters; a record that continues a text begins with its width.
    fn text(&mut self, length: usize, mut wide: bool) -> Result<String, String> {
        let mut units = Vec::new();
        while units.len() < length {
            if self.current.0.is_empty() {
                if !self.more() {
                    return Err("truncated in the shared strings".into());
                }
                wide = self.current.u8()? & 1 != 0;
            }
            let width = if wide { 2 } else { 1 };
            let count = (length - units.len()).min(self.current.0.len() / width);
            if count == 0 && !self.current.0.is_empty() {
                return Err("half a letter in the shared strings".into());
            }
            push_units(&mut units, self.current.bytes(count * width)?, wide);
        }
        Ok(String::from_utf16_lossy(&units))
    }
}

/// The cells of a sheet that hold any text.
fn cells(sheet: &[u8], strings: &[String], left: &mut Budget) -> Result<Cells, String> {
    let mut records = Records(sheet);
    if !matches!(records.next()?, Some((kind::BOF, _))) {
        return Err("a sheet does not begin where the workbook says".into());
    }
    let mut cells = Cells::new();
    // Charts within a sheet have records of cells too.
    let mut charts = 0_u32;
    let mut formula = (0, 0);
    while let Some((kind, content)) = records.next()? {
        let mut fields = Fields(content);
        match kind {
            kind::BOF => charts += 1,
            kind::EOF if charts == 0 => return Ok(cells),
            kind::EOF => charts -= 1,
            _ if charts > 0 => {}
            kind::LABEL_SST => {
                let (place, _format, at) = (fields.place()?, fields.u16()?, fields.u32()?);
                let text = strings.get(at as usize).ok_or("a cell refers to a missing shared string")?;
                left.keep(&mut cells, place, text)?;
            }
            kind::LABEL | kind::R_STRING => {
                let (place, _format) = (fields.place()?, fields.u16()?);
                left.keep(&mut cells, place, &fields.text()?)?;
            }
            kind::NUMBER => {
                let (place, _format) = (fields.place()?, fields.u16()?);
                left.keep(&mut cells, place, &number_text(fields.f64()?))?;
            }
            kind::RK => {
                let (place, _format) = (fields.place()?, fields.u16()?);
                left.keep(&mut cells, place, &number_text(short_number(fields.u32()?)))?;
            }
            kind::MUL_RK => {
                let (row, mut column) = fields.place()?;
                // The last column ends the record.
                while fields.0.len() >= 6 {
                    let _format = fields.u16()?;
                    left.keep(&mut cells, (row, column), &number_text(short_number(fields.u32()?)))?;
                    column += 1;
                }
            }
            kind::FORMULA => {
                formula = fields.place()?;
                let _format = fields.u16()?;
                let value: [u8; 8] = fields.array()?;
                match value {
                    [1, _, truth, .., 0xff, 0xff] => left.keep(&mut cells, formula, bool_text(truth))?,
                    // A text, which follows, an error or nothing.
                    [.., 0xff, 0xff] => {}
                    _ => left.keep(&mut cells, formula, &number_text(f64::from_le_bytes(value)))?,
                }
            }
            kind::STRING => left.keep(&mut cells, formula, &fields.text()?)?,
            kind::BOOL_ERR => {
                let (place, _format) = (fields.place()?, fields.u16()?);
                let (value, is_error) = (fields.u8()?, fields.u8()?);
                if is_error == 0 {
                    left.keep(&mut cells, place, bool_text(value))?;
                }
            }
            _ => {}
        }
    }
    Err("truncated in a sheet".into())
}

fn bool_text(value: u8) -> &'static str {
    if value == 0 { "false" } else { "true" }
}

/// A number in four bytes: a whole one of 30 bits or the upper half of a fraction; perhaps a hundred times too large.
fn short_number(bits: u32) -> f64 {
    let number = match bits & 2 {
        0 => f64::from_bits(u64::from(bits & !3) << 32),
        // The cast keeps the sign.
        _ => f64::from(bits as i32 >> 2),
    };
    if bits & 1 == 0 { number } else { number / 100.0 }
}

#[cfg(test)]
mod tests {
    use std::io::Write as _;

    use proptest::prelude::*;

    use super::*;

    fn record(kind: u16, content: &[u8]) -> Vec<u8> {
        let length = u16::try_from(content.len()).unwrap();
        [&kind.to_le_bytes(), &length.to_le_bytes(), content].concat()
    }

    fn cell(kind: u16, (row, column): (u16, u16), content: &[u8]) -> Vec<u8> {
        record(kind, &[&row.to_le_bytes(), &column.to_le_bytes(), &[0, 0], content].concat())
    }

    /// A workbook with one sheet of these records, and others among the shared ones.
    fn workbook(shared: &[Vec<u8>], sheet: &[Vec<u8>]) -> Vec<u8> {
        let begin = record(kind::BOF, &BIFF8.to_le_bytes());
        let end = record(kind::EOF, &[]);
        let shared = shared.concat();
        let at = u32::try_from(begin.len() + 10 + shared.len() + end.len()).unwrap();
        let listed = record(kind::BOUND_SHEET, &[&at.to_le_bytes()[..], &[0, 0]].concat());
        let stream = [begin.clone(), listed, shared, end.clone(), begin, sheet.concat(), end].concat();
        in_container(&stream)
    }

    fn in_container(stream: &[u8]) -> Vec<u8> {
        let mut file = cfb::CompoundFile::create(Cursor::new(Vec::new())).unwrap();
        file.create_stream("/Workbook").unwrap().write_all(stream).unwrap();
        file.flush().unwrap();
        file.into_inner().into_inner()
    }

    #[test]
    fn cells_of_every_kind_are_read() {
        // `ab`, `é` in two bytes that go on in the next record, and `x` with a run of formats and a phonetic text.
        let first = b"\x03\0\0\0\x03\0\0\0\x02\0\0ab\x03\0\x01c\0".to_vec();
        let more = b"\x00\xe9d\x01\0\x0c\x01\0\x02\0\0\0x\0\0\0\0pp".to_vec();
        let shared = [record(kind::SST, &first), record(kind::CONTINUE, &more)];
        let chart =
            [record(kind::BOF, &BIFF8.to_le_bytes()), cell(kind::NUMBER, (0, 0), &9_f64.to_le_bytes())];
        let sheet = [
            record(0x0200, &[0xff; 14]), // dimensions, which are not believed
            cell(kind::LABEL_SST, (0, 0), &0_u32.to_le_bytes()),
            cell(kind::LABEL_SST, (0, 1), &1_u32.to_le_bytes()),
            cell(kind::LABEL_SST, (0, 2), &2_u32.to_le_bytes()),
            chart.concat(),
            record(kind::EOF, &[]),
            cell(kind::NUMBER, (1, 0), &12_f64.to_le_bytes()),
            cell(kind::RK, (1, 1), &(((-7_i32) << 2) as u32 | 2).to_le_bytes()),
            cell(kind::RK, (1, 2), &((1234_u32 << 2) | 3).to_le_bytes()),
            record(
                kind::MUL_RK,
                &[[2, 0, 5, 0].as_slice(), &[0, 0, 22, 0, 0, 0], &[0, 0, 26, 0, 0, 0], &[6, 0]].concat(),
            ),
            cell(kind::FORMULA, (3, 0), &[&0.5_f64.to_le_bytes()[..], &[0; 8]].concat()),
            cell(kind::FORMULA, (3, 1), &[&[0, 0, 0, 0, 0, 0, 0xff, 0xff][..], &[0; 8]].concat()),
            record(kind::STRING, b"\x02\0\0hi"),
            cell(kind::FORMULA, (3, 2), &[&[1, 0, 1, 0, 0, 0, 0xff, 0xff][..], &[0; 8]].concat()),
            cell(kind::BOOL_ERR, (3, 3), &[0, 0]),
            cell(kind::BOOL_ERR, (3, 4), &[0x2a, 1]),
            cell(kind::LABEL, (3, 300), b"\x01\0\0y"),
        ];
        let sheets = read_workbook(workbook(&shared, &sheet)).unwrap();
        let text = |pairs: &[(u32, &str)]| pairs.iter().map(|(at, text)| (*at, (*text).to_owned())).collect();
        let expected = [
            (0, text(&[(0, "ab"), (1, "céd"), (2, "x")])),
            (1, text(&[(0, "12"), (1, "-7"), (2, "12.34")])),
            (2, text(&[(5, "5"), (6, "6")])),
            (3, text(&[(0, "0.5"), (1, "hi"), (2, "true"), (3, "false")])),
        ];
        assert_eq!(sheets, [Cells::from(expected)]);
    }

    #[test]
    fn what_cannot_be_read_is_named() {
        let refused =
            |shared: &[Vec<u8>], sheet: &[Vec<u8>]| read_workbook(workbook(shared, sheet)).unwrap_err();
        assert!(refused(&[record(kind::FILE_PASS, &[1, 0])], &[]).contains("encrypted"));
        assert!(refused(&[], &[cell(kind::LABEL_SST, (0, 0), &[0; 4])]).contains("missing shared string"));
        assert!(refused(&[], &[cell(kind::NUMBER, (0, 0), &[0; 4])]).contains("too short"));
        let endless = [&[0; 8][..], b"\xff\xff\x0c\xff\xff\xff\xff\xff\xffa"].concat();
        assert!(refused(&[record(kind::SST, &endless)], &[]).contains("truncated"));
        let same = record(kind::BOUND_SHEET, &[0; 6]);
        assert!(refused(&[same.clone(), same.clone()], &[]).contains("two sheets begin at byte 0"));
        assert!(refused(&vec![same; 64], &[]).contains("more than 64 sheets"));
        assert!(read_workbook(in_container(&record(kind::BOF, &[0, 5]))).unwrap_err().contains("older than"));
        let mut other = cfb::CompoundFile::create(Cursor::new(Vec::new())).unwrap();
        other.create_stream("/WordDocument").unwrap();
        assert!(read_workbook(other.into_inner().into_inner()).unwrap_err().contains("no stream `Workbook`"));
    }

    /// Cells that share a long text.
    #[test]
    fn repetition_is_limited() {
        let text = [&[0; 8][..], &8000_u16.to_le_bytes(), &[0], &[b'x'; 8000]].concat();
        let sheet: Vec<Vec<u8>> =
            (0..5000).map(|row| cell(kind::LABEL_SST, (row, 0), &0_u32.to_le_bytes())).collect();
        let bytes = workbook(&[record(kind::SST, &text)], &sheet);
        assert!(bytes.len() < 200_000);
        assert!(read_workbook(bytes).unwrap_err().contains("32 MiB of text"));
    }

    proptest! {
        /// Nor does a container with broken bytes.
        #[test]
        fn broken_containers_are_read_or_refused(changes in prop::collection::vec((0_usize..3072, any::<u8>()), 1..12), cut in 0_usize..8000) {
            let shared = record(kind::SST, b"\x01\0\0\0\x01\0\0\0\x02\0\0ab");
            let mut bytes = workbook(&[shared], &[cell(kind::LABEL_SST, (0, 0), &0_u32.to_le_bytes())]);
            for (at, byte) in changes {
                let at = at % bytes.len();
                bytes[at] = byte;
            }
            bytes.truncate(cut.max(600));
            let _ = read_workbook(bytes);
        }

        /// Whatever a record holds, the reader ends without a panic.
        #[test]
        fn any_record_is_read_or_refused(kinds in prop::collection::vec((0_usize..15, prop::collection::vec(any::<u8>(), 0..40)), 0..20)) {
            use kind::*;
            const KINDS: [u16; 15] = [
                FORMULA, EOF, FILE_PASS, CONTINUE, BOUND_SHEET, MUL_RK, R_STRING, SST, LABEL_SST, NUMBER, LABEL, BOOL_ERR, STRING,
                RK, BOF,
            ];
            let records: Vec<Vec<u8>> = kinds.iter().map(|(at, content)| record(KINDS[*at], content)).collect();
            let _ = read_workbook(workbook(&records, &[]));
            let _ = read_workbook(workbook(&[], &records));
        }
    }
}
