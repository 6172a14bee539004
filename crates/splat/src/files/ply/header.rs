//! The PLY container: its header, its scalar types, and the numbers of an ASCII body (Turk 1994).

use std::io::{self, Read};

use srflow_core::excerpt;
use srflow_files::FileProblem;

use crate::files::problem;

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
}

/// The element `vertex`.
#[derive(Debug)]
pub(super) struct Vertex {
    pub count: u64,
    pub properties: Vec<Property>,
}

impl Vertex {
    /// Bytes of one vertex in a binary body.
    pub(super) fn bytes(&self) -> usize {
        self.properties.iter().map(|property| property.scalar.bytes()).sum()
    }
}

/// The comment of antialiased Gaussians, as Brush writes it.
pub(super) const ANTIALIASED: &str = "comment SplatRenderMode: mip";

#[derive(Debug)]
pub(super) struct Header {
    pub encoding: Encoding,
    pub vertex: Vertex,
    /// Whether other elements follow the vertices.
    pub followed: bool,
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
            return Err(problem("magic", "`ply` on the first line", quote(&magic)));
        }
        let mut encoding = None;
        let mut vertex: Option<Vertex> = None;
        let mut followed = false;
        let mut antialiased = false;
        loop {
            let line = lines.next()?;
            match line.split_ascii_whitespace().collect::<Vec<_>>()[..] {
                ["end_header"] => break,
                ["comment", "SplatRenderMode:", "mip"] => antialiased = true,
                ["comment" | "obj_info", ..] | [] => {}
                ["format", name, "1.0"] => encoding = Some(parse_encoding(name)?),
                ["element", "vertex", count] if vertex.is_none() => {
                    let count =
                        count.parse().map_err(|_| problem("vertex count", "a number", quote(count)))?;
                    vertex = Some(Vertex { count, properties: Vec::new() });
                }
                ["element", name, ..] => {
                    if vertex.is_none() {
                        let expected = "`vertex` first (a compressed file must be exported uncompressed)";
                        return Err(problem("element", expected, quote(name)));
                    }
                    followed = true;
                }
                ["property", ..] if followed => {}
                ["property", kind, name] => {
                    let unknown = || problem("property type", "a scalar type of PLY", quote(&line));
                    let scalar = Scalar::parse(kind).ok_or_else(unknown)?;
                    let vertex = vertex
                        .as_mut()
                        .ok_or_else(|| problem("property", "an element first", quote(&line)))?;
                    if vertex.properties.iter().any(|property| property.name == name) {
                        return Err(problem("property", "each name once", format!("{} twice", quote(name))));
                    }
                    vertex.properties.push(Property { name: name.to_owned(), scalar });
                }
                _ => return Err(problem("header", "a line of a PLY header", quote(&line))),
            }
        }
        Ok(Self {
            encoding: encoding.ok_or_else(|| problem("format", "a line `format ... 1.0`", "none"))?,
            vertex: vertex.ok_or_else(|| problem("element", "`vertex`", "none"))?,
            followed,
            antialiased,
            bytes: lines.bytes,
        })
    }

    /// Checks that a file of `len` bytes can contain what the header claims.
    pub(super) fn check_file_size(&self, len: u64) -> Result<(), FileProblem> {
        // An ASCII value takes at least a digit and a space; the last space may be missing.
        let vertex_bytes = match self.encoding {
            Encoding::Ascii => 2 * self.vertex.properties.len() as u64,
            Encoding::LittleEndian | Encoding::BigEndian => self.vertex.bytes() as u64,
        };
        let needed = self.vertex.count.saturating_mul(vertex_bytes).saturating_add(self.bytes as u64);
        let exact = self.encoding != Encoding::Ascii && !self.followed;
        let slack = u64::from(self.encoding == Encoding::Ascii);
        if len + slack < needed || (exact && len != needed) {
            let least = if exact { "" } else { "at least " };
            let expected = format!("{least}{needed} bytes for {} vertices", self.vertex.count);
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

/// Iterates over the numbers of an ASCII body.
pub(super) struct Words<'a, R> {
    reader: &'a mut R,
    word: String,
}

impl<'a, R: Read> Words<'a, R> {
    pub(super) fn new(reader: &'a mut R) -> Self {
        Self { reader, word: String::new() }
    }

    /// The next number, which belongs to vertex number `vertex`.
    pub(super) fn number(&mut self, vertex: u64) -> Result<f64, FileProblem> {
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
            problem("vertex", "a number", format!("{found} at vertex {vertex}"))
        })
    }
}

impl<R: Read> Words<'_, R> {
    /// # Errors
    /// When anything but white space remains.
    pub(super) fn end(mut self, vertices: u64) -> Result<(), FileProblem> {
        self.word.clear();
        while let Some(byte) = read_byte(self.reader)? {
            if !byte.is_ascii_whitespace() {
                let expected = format!("the end of the file after {vertices} vertices");
                return Err(problem("vertices", expected, "more numbers: the header counts too few"));
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
