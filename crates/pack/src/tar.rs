//! Tars whose members are read one by one.

use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;

use sha2::{Digest, Sha256};
use srflow_core::excerpt;

use crate::error::ReadError;
use crate::names::field_of;
use crate::place::{Place, Windows};
use crate::ustar::{self, BLOCK, Block, Kind};

/// Bytes of a tar that are read at once while its headers are looked for: on disk, on the web.
const WINDOW: [u64; 2] = [16 << 10, 256 << 10];
/// Longest name or set of facts that may precede a member.
const LONGEST_FACTS: u64 = 1 << 20;
/// Members that are at most this far apart are read at once.
const GAP: u64 = 1 << 20;
/// Largest member in bytes: that of the largest file of flow, nearly.
pub(crate) const LARGEST_MEMBER: u32 = u32::MAX;

/// Largest tar in bytes, and most members of one: a server could send them without end.
const LARGEST_TAR: u64 = 1 << 40;
const MOST_MEMBERS: u64 = 1 << 22;
/// Most members of a sample.
const MOST_ENDINGS: usize = u8::MAX as usize + 1;

/// A tar on disk or on the web.
#[derive(Debug, PartialEq, Eq)]
pub struct Tar {
    pub place: Place,
}

/// The members of one sample. A list of a million of them is in memory at once.
#[derive(Debug)]
pub struct SampleMembers {
    pub tar: Arc<Tar>,
    /// The first part of the members' names.
    pub key: Box<str>,
    /// The rest of their names, such as `flow.npy`: one list for all samples that have the same.
    pub endings: Arc<[Box<str>]>,
    /// Where they are, in the same order.
    pub spans: Box<[Span]>,
}

impl SampleMembers {
    /// `flow` of `flow.npy`, for each member.
    pub fn fields(&self) -> impl Iterator<Item = &str> {
        self.endings.iter().map(|ending| field_of(ending))
    }
}

/// The list as it is kept: `last` if it is the same.
pub(crate) fn shared(endings: &[impl AsRef<str>], last: &mut Arc<[Box<str>]>) -> Arc<[Box<str>]> {
    if !last.iter().map(|ending| &**ending).eq(endings.iter().map(AsRef::as_ref)) {
        *last = endings.iter().map(|ending| ending.as_ref().into()).collect();
    }
    last.clone()
}

/// Where a member is.
#[derive(Debug, Clone, Copy)]
pub struct Span {
    /// Where its content starts in the tar, in bytes.
    pub offset: u64,
    /// Size of its content in bytes.
    pub size: u32,
    /// The first half of the SHA-256 that the index states of its content.
    pub sha256: Option<[u8; 16]>,
}

impl Span {
    fn end(&self) -> u64 {
        self.offset.saturating_add(self.size.into())
    }
}

/// A file of a sample in a tar.
#[derive(Debug, Clone)]
pub struct Member {
    sample: Arc<SampleMembers>,
    /// Its number in the sample.
    at: u8,
}

/// Members are equal when their content is known to be: frames that two pairs share are stored twice.
impl PartialEq for Member {
    fn eq(&self, other: &Self) -> bool {
        let (own, others) = (self.span(), other.span());
        match (own.sha256, others.sha256) {
            (Some(own), Some(others)) => own == others,
            _ => own.offset == others.offset && self.sample.tar == other.sample.tar,
        }
    }
}

impl Member {
    /// The member of a sample with this field, such as `flow`, if it has one.
    pub fn of(sample: &Arc<SampleMembers>, field: &str) -> Option<Self> {
        let at = sample.fields().position(|own| own == field)?;
        Some(Self { sample: sample.clone(), at: u8::try_from(at).ok()? })
    }

    fn span(&self) -> Span {
        self.sample.spans[usize::from(self.at)]
    }

    fn name(&self) -> String {
        format!("{}.{}", self.sample.key, self.sample.endings[usize::from(self.at)])
    }

    /// Compares its content with what the index states.
    fn check(&self, content: &[u8]) -> Result<(), String> {
        let Some(expected) = self.span().sha256 else { return Ok(()) };
        let found = Sha256::digest(content);
        if found.starts_with(&expected) {
            return Ok(());
        }
        let [expected, found] = [&expected[..], &found[..expected.len()]]
            .map(|digits| digits.iter().map(|byte| format!("{byte:02x}")).collect::<String>());
        Err(format!("expected {} with a SHA-256 that starts with {expected}, found {found}", self.name()))
    }

    /// `TAR/KEY.FIELD.ENDING`.
    pub fn path(&self) -> PathBuf {
        self.sample.tar.place.path().join(self.name())
    }
}

/// The content of several members of one sample, read at once where they are close.
#[derive(Debug, Default)]
pub struct Contents {
    /// Where in the tar each piece starts, and the piece.
    pieces: Vec<(u64, Vec<u8>)>,
}

impl Contents {
    /// Reads the members, which must be those of one sample, and compares them with the index where there is one.
    pub fn read(members: &[&Member]) -> Result<Self, ReadError> {
        let Some(first) = members.first() else { return Ok(Self::default()) };
        let mut sorted = members.to_vec();
        sorted.sort_by_key(|member| member.span().offset);
        let mut ranges: Vec<(Range<u64>, Vec<&Member>)> = Vec::new();
        for member in sorted {
            let span = member.span();
            match ranges.last_mut() {
                Some((range, inside)) if span.offset <= range.end.saturating_add(GAP) => {
                    range.end = range.end.max(span.end());
                    inside.push(member);
                }
                _ => ranges.push((span.offset..span.end(), vec![member])),
            }
        }
        let place = &first.sample.tar.place;
        let read = |(range, inside): (Range<u64>, Vec<&Member>)| {
            let start = range.start;
            let check = |bytes: &[u8]| {
                inside.iter().try_for_each(|member| member.check(piece(start, bytes, member.span())))
            };
            Ok((start, place.read(range, &check)?))
        };
        Ok(Self { pieces: ranges.into_iter().map(read).collect::<Result<_, ReadError>>()? })
    }

    /// The content of one of the members.
    pub fn get(&self, member: &Member) -> &[u8] {
        let span = member.span();
        let holds = |(start, bytes): &&(u64, Vec<u8>)| {
            *start <= span.offset && span.end() - *start <= bytes.len() as u64
        };
        self.pieces.iter().find(holds).map_or(&[], |(start, bytes)| piece(*start, bytes, span))
    }
}

fn piece(start: u64, bytes: &[u8], span: Span) -> &[u8] {
    let from = usize::try_from(span.offset - start).unwrap_or(usize::MAX);
    let to = usize::try_from(span.end() - start).unwrap_or(usize::MAX);
    bytes.get(from..to).unwrap_or_default()
}

/// Finds the samples of a tar by its headers: members whose names are the same up to the first dot, and adjacent.
pub fn scan(place: Place, on_sample: &mut dyn FnMut(SampleMembers)) -> Result<(), ReadError> {
    let tar = Arc::new(Tar { place });
    let mut windows = Windows::new(&tar.place, WINDOW);
    let mut last = Arc::from([]);
    let mut current: Option<(String, Vec<Box<str>>, Vec<Span>)> = None;
    let mut finish = |current: Option<(String, Vec<Box<str>>, Vec<Span>)>| {
        if let Some((key, endings, spans)) = current {
            let (tar, endings) = (tar.clone(), shared(&endings, &mut last));
            on_sample(SampleMembers { tar, key: key.into(), endings, spans: spans.into() });
        }
    };
    let (mut offset, mut long_name, mut long_size) = (0_u64, None, None);
    for members in 0_u64.. {
        let wrong = |reason: String| ReadError::Content {
            path: tar.place.path(),
            reason: format!("at byte {offset}: {reason}"),
        };
        let header: Option<[u8; BLOCK as usize]> = windows.get(offset, BLOCK)?.try_into().ok();
        let Some(header) = header else {
            return Err(wrong(
                "expected a header or the end of the tar, found the end of the file: copy it again".into(),
            ));
        };
        let Block::Member { name, size, kind } = ustar::parse(&header).map_err(wrong)? else { break };
        if windows.total() > LARGEST_TAR || members >= MOST_MEMBERS {
            let found = format!("{} bytes with {members} members and more", windows.total());
            return Err(wrong(format!(
                "expected a tar of at most {LARGEST_TAR} bytes and {MOST_MEMBERS} members, found {found}: divide it"
            )));
        }
        let size = long_size.take().filter(|_| kind == Kind::File).unwrap_or(size);
        let start = offset + BLOCK;
        let end = ustar::padded(size).and_then(|padded| start.checked_add(padded));
        let inside = end.filter(|_| start + size <= windows.total());
        let (Some(end), Ok(content_size)) = (inside, u32::try_from(size)) else {
            let most = windows.total().saturating_sub(start).min(LARGEST_MEMBER.into());
            let name = excerpt(&name);
            return Err(wrong(format!(
                "expected at most {most} bytes of {name}, found a size of {size}: copy it again"
            )));
        };
        match kind {
            Kind::LongName | Kind::Pax if size > LONGEST_FACTS => {
                return Err(wrong(format!("expected a name of at most {LONGEST_FACTS} bytes, found {size}")));
            }
            Kind::LongName => {
                let name = windows.get(start, size)?;
                long_name = Some(String::from_utf8_lossy(name).trim_end_matches('\0').to_owned());
            }
            Kind::Pax => {
                let (name, size) = ustar::pax(windows.get(start, size)?).map_err(wrong)?;
                long_name = name.or(long_name);
                long_size = size;
            }
            Kind::Other => long_name = None,
            Kind::File => {
                let name = long_name.take().unwrap_or(name);
                let folder = name.rfind('/').map_or(0, |at| at + 1);
                let dot = name[folder..].find('.').filter(|dot| *dot > 0);
                // Hidden files, and those without an extension, are not of a sample.
                if let Some(dot) = dot.map(|dot| folder + dot) {
                    let (key, ending) = (&name[..dot], &name[dot + 1..]);
                    let ending = ending.into();
                    let span = Span { offset: start, size: content_size, sha256: None };
                    match &mut current {
                        Some((last, endings, _)) if last == key && endings.len() == MOST_ENDINGS => {
                            let name = excerpt(key);
                            return Err(wrong(format!(
                                "expected at most {MOST_ENDINGS} members of {name}, found more"
                            )));
                        }
                        Some((last, endings, spans)) if last == key => {
                            endings.push(ending);
                            spans.push(span);
                        }
                        _ => finish(current.replace((key.to_owned(), vec![ending], vec![span]))),
                    }
                }
            }
        }
        offset = end;
    }
    finish(current);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A member with its header, of this type.
    fn member(name: &str, content: &[u8], kind: u8) -> Vec<u8> {
        let mut header = ustar::header(name, content.len() as u64).unwrap();
        let sum: u32 = u32::from_str_radix(std::str::from_utf8(&header[148..154]).unwrap(), 8).unwrap();
        header[156] = kind;
        let sum = sum - u32::from(b'0') + u32::from(kind);
        header[148..154].copy_from_slice(format!("{sum:06o}").as_bytes());
        let mut bytes = [&header[..], content].concat();
        bytes.resize(bytes.len().next_multiple_of(BLOCK as usize), 0);
        bytes
    }

    /// A key, and endings and sizes of its members.
    type Found = (String, Vec<(String, u64)>);

    fn samples(bytes: &[u8]) -> Result<Vec<Found>, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.tar");
        std::fs::write(&path, bytes).unwrap();
        let mut samples = Vec::new();
        let scanned = scan(Place::Disk(path), &mut |sample| {
            let sizes = sample.spans.iter().map(|span| u64::from(span.size));
            let spans = sample.endings.iter().map(|ending| ending.to_string()).zip(sizes).collect();
            samples.push((sample.key.to_string(), spans));
        });
        scanned.map(|()| samples).map_err(|error| error.to_string())
    }

    #[test]
    fn members_with_the_same_key_are_a_sample() {
        let long = format!("{}/b_1.frame1.png", "d".repeat(150));
        let record = format!("path={long}\n");
        let pax = format!("{} {record}", record.len() + 4);
        let tar = [
            member("set/", b"", b'5'),
            member("README", b"text", b'0'),
            member(".hidden.png", b"text", b'0'),
            member("set/a.b/c_0.flow.npy", b"1234", b'0'),
            member("set/a.b/c_0.meta.json", &[b'x'; 600], b'0'),
            member("././@LongLink", format!("{long}\0").as_bytes(), b'L'),
            member(&long[..100], b"12", b'0'),
            member("pax", pax.as_bytes(), b'x'),
            member(&long[..100], b"123", b'0'),
            member("e.frame1.png", b"", b'0'),
            vec![0; 1024],
        ];
        let found = samples(&tar.concat()).unwrap();
        let spans =
            |spans: &[(&str, u64)]| spans.iter().map(|(name, size)| ((*name).to_owned(), *size)).collect();
        let expected: [Found; 3] = [
            ("set/a.b/c_0".to_owned(), spans(&[("flow.npy", 4), ("meta.json", 600)])),
            (long.replace(".frame1.png", ""), spans(&[("frame1.png", 2), ("frame1.png", 3)])),
            ("e".to_owned(), spans(&[("frame1.png", 0)])),
        ];
        assert_eq!(found, expected);
        let cut = samples(&tar.concat()[..2000]).unwrap_err();
        assert!(cut.contains("a.tar: at byte") && cut.contains("copy it again"), "{cut}");
        let many: Vec<Vec<u8>> = (0..257).map(|number| member(&format!("a.{number}"), b"", b'0')).collect();
        assert!(samples(&many.concat()).unwrap_err().contains("at most 256 members of a"));
        assert!(samples(b"no tar at all").unwrap_err().contains("the end of the file"));
        assert!(samples(&[b'x'; 600]).unwrap_err().contains("wrong checksum"));
    }
}
