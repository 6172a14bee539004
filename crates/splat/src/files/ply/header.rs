//! The PLY container: its header, its scalar types, and the numbers of an ASCII body (Turk 1994).

use std::io::{self, Read};

use srflow_core::{excerpt, excerpts};
use srflow_files::FileProblem;

use crate::files::{SplatFormat, problem};

/// Maximum length of a header in bytes, far above that of any file of Gaussians.
const MAX_HEADER: usize = 1 << 16;

pub(super) fn reading(error: io::Error) -> FileProblem {
    FileProblem::Io { doing: "reading", error }
}

/// The encoding of the body.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Encoding {
    Ascii,
    LittleEndian,
    BigEndian,
}

/// Type of a property.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    fn parse(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    pub(super) fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// The number in the first [`Scalar::bytes`] of `bytes`.
    pub(super) fn decode(self, bytes: &[u8], encoding: Encoding) -> f64 {
        let mut little = [0; 8];
        let count = self.bytes();
        little[..count].copy_from_slice(&bytes[..count]);
        if encoding == Encoding::BigEndian {
            little[..count].reverse();
        }
        let bits = u64::from_le_bytes(little);
        match self {
            Self::I8 => f64::from(bits as i8),
            Self::U8 => f64::from(bits as u8),
            Self::I16 => f64::from(bits as i16),
            Self::U16 => f64::from(bits as u16),
            Self::I32 => f64::from(bits as i32),
            Self::U32 => f64::from(bits as u32),
            Self::F32 => f64::from(f32::from_bits(bits as u32)),
            Self::F64 => f64::from_bits(bits),
        }
    }
}

#[derive(Debug)]
pub(super) struct Property {
    pub name: String,
    pub scalar: Scalar,
    /// Of a list of such numbers: the type of its length.
    pub length: Option<Scalar>,
}

/// A table of the body.
#[derive(Debug)]
pub(super) struct Element {
    pub name: String,
    pub count: u64,
    pub properties: Vec<Property>,
}

impl Element {
    /// Bytes of one row in a binary body; lists count as empty.
    pub(super) fn row_bytes(&self) -> usize {
        self.properties.iter().map(|property| property.length.unwrap_or(property.scalar).bytes()).sum()
    }

    pub(super) fn has_lists(&self) -> bool {
        self.properties.iter().any(|property| property.length.is_some())
    }

    /// Position of a property among the values of a row.
    pub(super) fn find(&self, name: &str) -> Option<usize> {
        self.properties.iter().position(|property| property.name == name)
    }
}

/// The comment of antialiased Gaussians, as Brush writes it.
pub(super) const ANTIALIASED: &str = "comment SplatRenderMode: mip";

#[derive(Debug)]
pub(super) struct Header {
    pub encoding: Encoding,
    /// In the order of the body.
    pub elements: Vec<Element>,
    /// Whether a comment says so; see [`ANTIALIASED`].
    pub antialiased: bool,
    /// Length of the header in the file.
    bytes: usize,
}

impl Header {
    /// Reads up to and including the line `end_header`.
    pub(super) fn read(reader: &mut impl Read) -> Result<Self, FileProblem> {
        let mut lines = Lines { reader, bytes: 0 };
        let magic = lines.next()?;
        if magic != "ply" {
            let expected =
                format!("`ply` on the first line (formats by ending: {})", SplatFormat::extensions());
            return Err(problem("magic", expected, quote(&magic)));
        }
        let mut encoding = None;
        let mut elements: Vec<Element> = Vec::new();
        let mut antialiased = false;
        loop {
            let line = lines.next()?;
            let scalar = |kind: &str| {
                Scalar::parse(kind)
                    .ok_or_else(|| problem("property type", "a scalar type of PLY", quote(&line)))
            };
            let (length, kind, name) = match line.split_ascii_whitespace().collect::<Vec<_>>()[..] {
                ["end_header"] => break,
                ["comment", "SplatRenderMode:", "mip"] => {
                    antialiased = true;
                    continue;
                }
                ["comment" | "obj_info", ..] | [] => continue,
                ["format", name, "1.0"] => {
                    encoding = Some(parse_encoding(name)?);
                    continue;
                }
                ["element", name, count] => {
                    let count = count.parse().map_err(|_| problem("count", "a number", quote(&line)))?;
                    if elements.iter().any(|element| element.name == name) {
                        return Err(problem("element", "each name once", format!("{} twice", quote(name))));
                    }
                    elements.push(Element { name: name.to_owned(), count, properties: Vec::new() });
                    continue;
                }
                ["property", "list", length, kind, name] => (Some(scalar(length)?), scalar(kind)?, name),
                ["property", kind, name] => (None, scalar(kind)?, name),
                _ => return Err(problem("header", "a line of a PLY header", quote(&line))),
            };
            let element =
                elements.last_mut().ok_or_else(|| problem("property", "an element first", quote(&line)))?;
            if element.find(name).is_some() {
                return Err(problem("property", "each name once", format!("{} twice", quote(name))));
            }
            element.properties.push(Property { name: name.to_owned(), scalar: kind, length });
        }
        Ok(Self {
            encoding: encoding.ok_or_else(|| problem("format", "a line `format ... 1.0`", "none"))?,
            elements,
            antialiased,
            bytes: lines.bytes,
        })
    }

    /// The elements and their rows, for messages: `3 of chunk, 700 of vertex`.
    pub(super) fn counts(&self) -> String {
        let counts = self.elements.iter().map(|element| format!("{} of {}", element.count, element.name));
        excerpts(counts.collect::<Vec<_>>().iter().map(String::as_str), 8)
    }

    /// Checks that a file of `len` bytes can contain what the header claims.
    pub(super) fn check_file_size(&self, len: u64) -> Result<(), FileProblem> {
        let ascii = self.encoding == Encoding::Ascii;
        // An ASCII value takes at least a digit and a space; the last space may be missing.
        let row = |element: &Element| if ascii { 2 * element.properties.len() } else { element.row_bytes() };
        let needed = self.elements.iter().fold(self.bytes as u64, |sum, element| {
            sum.saturating_add(element.count.saturating_mul(row(element) as u64))
        });
        let exact = !ascii && !self.elements.iter().any(Element::has_lists);
        if len + u64::from(ascii) < needed || (exact && len != needed) {
            let least = if exact { "" } else { "at least " };
            let expected = format!("{least}{needed} bytes for {}", self.counts());
            return Err(problem("file size", expected, format!("{len} bytes")));
        }
        Ok(())
    }
}

fn parse_encoding(name: &str) -> Result<Encoding, FileProblem> {
    Ok(match name {
        "ascii" => Encoding::Ascii,
        "binary_little_endian" => Encoding::LittleEndian,
        "binary_big_endian" => Encoding::BigEndian,
        _ => {
            let expected = "ascii, binary_little_endian or binary_big_endian";
            return Err(problem("format", expected, quote(name)));
        }
    })
}

fn quote(text: &str) -> String {
    format!("\"{}\"", excerpt(text))
}

struct Lines<'a, R> {
    reader: &'a mut R,
    bytes: usize,
}

impl<R: Read> Lines<'_, R> {
    fn next(&mut self) -> Result<String, FileProblem> {
        let mut line = Vec::new();
        loop {
            let Some(byte) = read_byte(self.reader)? else {
                return Err(problem("header", "a line `end_header`", "the end of the file"));
            };
            self.bytes += 1;
            if self.bytes > MAX_HEADER {
                return Err(problem("header", format!("`end_header` within {MAX_HEADER} bytes"), "none"));
            }
            match byte {
                b'\n' => break,
                b'\r' => {}
                _ => line.push(byte),
            }
        }
        Ok(String::from_utf8_lossy(&line).into_owned())
    }
}

/// The rows of a body, one after another.
pub(super) struct Body<'a, R> {
    reader: &'a mut R,
    encoding: Encoding,
    /// Of one row of a binary body.
    bytes: Vec<u8>,
    word: String,
}

impl<'a, R: Read> Body<'a, R> {
    pub(super) fn new(reader: &'a mut R, encoding: Encoding) -> Self {
        Self { reader, encoding, bytes: Vec::new(), word: String::new() }
    }

    /// The numbers of row number `row` of an element without lists.
    pub(super) fn row(&mut self, element: &Element, row: u64, values: &mut [f64]) -> Result<(), FileProblem> {
        if self.encoding == Encoding::Ascii {
            return values.iter_mut().try_for_each(|value| {
                *value = self.word(&element.name, row)?;
                Ok(())
            });
        }
        self.bytes.resize(element.row_bytes(), 0);
        self.reader.read_exact(&mut self.bytes).map_err(reading)?;
        let mut rest = &self.bytes[..];
        for (value, property) in values.iter_mut().zip(&element.properties) {
            let (this, others) = rest.split_at(property.scalar.bytes());
            *value = property.scalar.decode(this, self.encoding);
            rest = others;
        }
        Ok(())
    }

    /// Passes over all rows of an element.
    pub(super) fn skip(&mut self, element: &Element) -> Result<(), FileProblem> {
        if self.encoding != Encoding::Ascii && !element.has_lists() {
            return self.skip_bytes(element.count.saturating_mul(element.row_bytes() as u64));
        }
        if element.properties.is_empty() {
            return Ok(());
        }
        for row in 0..element.count {
            for property in &element.properties {
                let Some(length) = property.length else {
                    self.number(&element.name, row, property.scalar)?;
                    continue;
                };
                let length = self.number(&element.name, row, length)?;
                if length.fract() != 0.0 || !(0.0..=f64::from(u32::MAX)).contains(&length) {
                    let found = format!("{length} in row {row} of {}", quote(&element.name));
                    return Err(problem("length of a list", "a number from 0", found));
                }
                if self.encoding == Encoding::Ascii {
                    (0..length as u64).try_for_each(|_| self.word(&element.name, row).map(drop))?;
                } else {
                    self.skip_bytes(length as u64 * property.scalar.bytes() as u64)?;
                }
            }
        }
        Ok(())
    }

    fn skip_bytes(&mut self, count: u64) -> Result<(), FileProblem> {
        let skipped = io::copy(&mut self.reader.by_ref().take(count), &mut io::sink()).map_err(reading)?;
        if skipped == count { Ok(()) } else { Err(reading(io::ErrorKind::UnexpectedEof.into())) }
    }

    fn number(&mut self, element: &str, row: u64, scalar: Scalar) -> Result<f64, FileProblem> {
        if self.encoding == Encoding::Ascii {
            return self.word(element, row);
        }
        let mut bytes = [0; 8];
        let bytes = &mut bytes[..scalar.bytes()];
        self.reader.read_exact(bytes).map_err(reading)?;
        Ok(scalar.decode(bytes, self.encoding))
    }

    /// The next number of an ASCII body.
    fn word(&mut self, element: &str, row: u64) -> Result<f64, FileProblem> {
        const MAX_WORD: usize = 64;
        self.word.clear();
        loop {
            match read_byte(self.reader)? {
                Some(byte) if byte.is_ascii_whitespace() => {
                    if !self.word.is_empty() {
                        break;
                    }
                }
                Some(byte) if self.word.len() < MAX_WORD => self.word.push(char::from(byte)),
                Some(_) | None => break,
            }
        }
        self.word.parse().map_err(|_| {
            let found =
                if self.word.is_empty() { "the end of the file".to_owned() } else { quote(&self.word) };
            problem("body", "a number", format!("{found} in row {row} of {}", quote(element)))
        })
    }

    /// # Errors
    /// When anything but white space remains of an ASCII body.
    pub(super) fn end(self) -> Result<(), FileProblem> {
        while self.encoding == Encoding::Ascii
            && let Some(byte) = read_byte(self.reader)?
        {
            if !byte.is_ascii_whitespace() {
                let expected = "the end of the file after all rows";
                return Err(problem("body", expected, "more numbers: the header counts too few"));
            }
        }
        Ok(())
    }
}

fn read_byte(reader: &mut impl Read) -> Result<Option<u8>, FileProblem> {
    let mut byte = [0];
    loop {
        match reader.read(&mut byte) {
            Ok(0) => return Ok(None),
            Ok(_) => return Ok(Some(byte[0])),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(reading(error)),
        }
    }
}
