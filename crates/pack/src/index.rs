//! `index.jsonl`: where the members of each pair are, so that any pair can be read without the ones before it.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::sync::Arc;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use srflow_core::excerpt;
use srflow_files::parse_error_in_words;

use crate::error::ReadError;
use crate::names::{field_of, is_plain};
use crate::place::Place;
use crate::split::SceneSplit;
use crate::tar::{LARGEST_MEMBER, SampleMembers, Span, Tar, shared};

/// Name of the file in the folder of a packed dataset.
pub const INDEX_NAME: &str = "index.jsonl";

/// Longest line in bytes; a dataset with all fields has lines of 2000.
const LONGEST_LINE: usize = 1 << 16;
/// Bytes that are read at once.
const CHUNK: u64 = 4 << 20;
const MOST_PAIRS: usize = 1 << 24;
/// Lines that are parsed at once.
const BATCH: usize = 1 << 12;

/// A line of the index.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct IndexRecord {
    /// First part of its members' names.
    pub key: String,
    pub split: SceneSplit,
    /// Empty in datasets without scenes.
    pub scene: String,
    /// Name of the pair within its scene.
    pub frame: String,
    pub tar: String,
    /// Where the header of its first member starts in the tar, in bytes.
    pub offset: u64,
    /// Size of all members with their headers, in bytes.
    pub size: u64,
    /// By the rest of their names, e.g. `flow.npy`.
    pub members: BTreeMap<String, MemberRecord>,
    /// Statistics of the flow on the head, or of the whole flow in datasets without masks.
    pub flow: FlowStatistics,
    /// Largest difference of a component between the packed flow and that of the dataset, in pixels.
    pub flow_error: f32,
}

/// Where a member is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct MemberRecord {
    /// Where its content starts in the tar, in bytes.
    pub offset: u64,
    /// Size of its content in bytes.
    pub size: u64,
    /// SHA-256 of its content in hexadecimal digits.
    pub sha256: String,
}

/// Magnitudes of a flow.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct FlowStatistics {
    /// How many pixels are counted.
    pub pixels: u64,
    /// How many of them are not visible in frame 2.
    pub occluded: u64,
    /// Sum of the magnitudes, in pixels.
    pub sum: f64,
    /// Largest magnitude, in pixels.
    pub max: f32,
}

impl FlowStatistics {
    /// Adds those of another pair.
    pub fn add(&mut self, other: &Self) {
        self.pixels += other.pixels;
        self.occluded += other.occluded;
        self.sum += other.sum;
        self.max = self.max.max(other.max);
    }

    /// Mean magnitude in pixels; 0 without pixels.
    pub fn mean(&self) -> f64 {
        if self.pixels == 0 { 0.0 } else { self.sum / self.pixels as f64 }
    }
}

/// What a reader needs of a line; text is that of the line, which has no escapes where `srflow pack` wrote it.
#[derive(Deserialize)]
struct ReadRecord<'a> {
    #[serde(borrow)]
    key: Cow<'a, str>,
    split: SceneSplit,
    #[serde(borrow)]
    scene: Cow<'a, str>,
    #[serde(borrow)]
    frame: Cow<'a, str>,
    #[serde(borrow)]
    tar: Cow<'a, str>,
    #[serde(borrow)]
    members: BTreeMap<Ending<'a>, ReadMember<'a>>,
}

/// The end of a member's name.
#[derive(Deserialize, PartialEq, Eq, PartialOrd, Ord)]
#[serde(transparent)]
struct Ending<'a>(#[serde(borrow)] Cow<'a, str>);

impl AsRef<str> for Ending<'_> {
    fn as_ref(&self) -> &str {
        &self.0
    }
}

#[derive(Deserialize)]
struct ReadMember<'a> {
    offset: u64,
    size: u64,
    #[serde(borrow)]
    sha256: Cow<'a, str>,
}

/// A pair of a packed dataset.
#[derive(Debug)]
pub struct Listing {
    pub split: Option<SceneSplit>,
    pub scene: String,
    pub frame: String,
    pub members: SampleMembers,
}

/// Reads the index of a packed dataset in the folder `dir`, a part at a time. Members of other fields than `fields` are left out. Calls
/// `on_pair` with each pair, and about how many pairs there are.
///
/// # Errors
/// When it cannot be read, or a line has other content than `srflow pack` writes.
pub fn read_index(
    dir: &Place,
    fields: &[&str],
    on_pair: &mut dyn FnMut(Listing, usize),
) -> Result<(), ReadError> {
    let place = dir.join(INDEX_NAME);
    let mut tars: BTreeMap<String, Arc<Tar>> = BTreeMap::new();
    let mut last = Arc::from([]);
    let (mut read, mut pairs, mut about) = (0_usize, 0, None);
    let on_block = |block: &[u8], total: u64| {
        let lines = block.split(|byte| *byte == b'\n');
        let first = read + 1;
        read += lines.clone().count();
        let mut filled = lines.zip(first..).filter(|(line, _)| !line.is_empty());
        let about = *about.get_or_insert_with(|| {
            let found = filled.clone().count() as u64;
            usize::try_from(total.saturating_mul(found) / (block.len() as u64 + 1))
                .unwrap_or(MOST_PAIRS)
                .min(MOST_PAIRS)
        });
        // A batch at a time: what is read of a line takes more memory than a short line does.
        let batches = std::iter::from_fn(|| {
            let batch: Vec<_> = filled.by_ref().take(BATCH).collect();
            (!batch.is_empty()).then(|| {
                let parse = |&(line, number)| (number, ReadPair::parse(line, fields));
                batch.par_iter().map(parse).collect::<Vec<_>>()
            })
        });
        for (number, parsed) in batches.flatten() {
            let wrong = |reason: String| ReadError::Content {
                path: place.path(),
                reason: format!("line {number}: {reason}; copy the index again, or pack the dataset again"),
            };
            let ReadPair { record, endings, spans } = parsed.map_err(wrong)?;
            pairs += 1;
            if pairs > MOST_PAIRS {
                return Err(wrong(format!("expected at most {MOST_PAIRS} pairs, found more")));
            }
            let ReadRecord { key, split, scene, frame, tar, .. } = record;
            let tar = match tars.get(&*tar) {
                Some(tar) => tar.clone(),
                None => {
                    let found = Arc::new(Tar { place: dir.join(&tar) });
                    tars.insert(tar.into_owned(), found.clone());
                    found
                }
            };
            let endings = shared(&endings, &mut last);
            let members = SampleMembers { tar, key: key.into(), endings, spans };
            let (scene, frame) = (scene.into_owned(), frame.into_owned());
            on_pair(Listing { split: Some(split), scene, frame, members }, about);
        }
        Ok(())
    };
    blocks(&place, on_block)
}

/// A line that was read, with the members that are asked for.
struct ReadPair<'a> {
    /// Without its members.
    record: ReadRecord<'a>,
    endings: Vec<Ending<'a>>,
    spans: Box<[Span]>,
}

impl<'a> ReadPair<'a> {
    /// # Errors
    /// What was expected, and what was found.
    fn parse(line: &'a [u8], fields: &[&str]) -> Result<Self, String> {
        let mut record: ReadRecord =
            serde_json::from_slice(line).map_err(|error| parse_error_in_words(&error))?;
        check(&record)?;
        let mut members = std::mem::take(&mut record.members);
        members.retain(|ending, _| fields.contains(&field_of(ending.as_ref())));
        // A list that grows leaves holes in memory that nothing else fits into.
        let (mut endings, mut spans) = (Vec::new(), Vec::with_capacity(members.len()));
        for (ending, member) in members {
            let digest = digest(&member.sha256).ok_or_else(|| {
                format!("sha256: expected 64 hexadecimal digits, found `{}`", excerpt(&member.sha256))
            })?;
            let Ok(size) = u32::try_from(member.size) else { continue }; // checked above
            endings.push(ending);
            spans.push(Span { offset: member.offset, size, sha256: Some(digest) });
        }
        Ok(Self { record, endings, spans: spans.into() })
    }
}

/// # Errors
/// What was expected, and what was found.
fn check(record: &ReadRecord) -> Result<(), String> {
    let plain =
        [("key", &record.key, false), ("scene", &record.scene, true), ("frame", &record.frame, false)];
    for (field, name, may_be_empty) in plain {
        if !(is_plain(name) || (may_be_empty && name.is_empty())) {
            let name = excerpt(name);
            return Err(format!(
                "{field}: expected letters, digits, hyphens and underscores, found `{name}`"
            ));
        }
    }
    if !record.tar.strip_suffix(".tar").is_some_and(is_plain) {
        return Err(format!(
            "tar: expected a name such as train-000000.tar, found `{}`",
            excerpt(&record.tar)
        ));
    }
    for (Ending(ending), member) in &record.members {
        let is_name = ending.len() <= 40 && ending.split('.').all(is_plain);
        if !is_name {
            let ending = excerpt(ending);
            return Err(format!("members: expected the end of a name such as flow.npy, found `{ending}`"));
        }
        let end = member.offset.checked_add(member.size);
        if end.is_none_or(|end| end > i64::MAX as u64) || member.size > LARGEST_MEMBER.into() {
            let ReadMember { offset, size, .. } = member;
            return Err(format!(
                "{ending}: expected at most {LARGEST_MEMBER} bytes inside a tar, found {size} bytes from byte {offset}"
            ));
        }
    }
    Ok(())
}

/// The first 16 bytes of 64 hexadecimal digits.
fn digest(text: &str) -> Option<[u8; 16]> {
    let digit = |byte: u8| char::from(byte).to_digit(16);
    let mut digest = [0; 16];
    if text.len() != 64 || !text.bytes().all(|byte| byte.is_ascii_hexdigit()) {
        return None;
    }
    for (byte, [high, low]) in digest.iter_mut().zip(text.as_bytes().as_chunks::<2>().0) {
        *byte = (digit(*high)? << 4 | digit(*low)?) as u8;
    }
    Some(digest)
}

/// Calls `on_line` with each line of a file, without its line break.
pub(crate) fn lines(
    place: &Place,
    on_line: &mut dyn FnMut(&[u8]) -> Result<(), ReadError>,
) -> Result<(), ReadError> {
    blocks(place, |block, _| block.split(|byte| *byte == b'\n').try_for_each(&mut *on_line))
}

/// Calls `on_block` with the lines of a file, many at a time, without the last line break, and with the size of the file in bytes.
fn blocks(
    place: &Place,
    mut on_block: impl FnMut(&[u8], u64) -> Result<(), ReadError>,
) -> Result<(), ReadError> {
    let wrong = |reason: String| ReadError::Content { path: place.path(), reason };
    let (mut pending, mut offset) = (Vec::new(), 0_u64);
    loop {
        let part = place.read_up_to(offset..offset + CHUNK)?;
        offset += part.bytes.len() as u64;
        pending.extend_from_slice(&part.bytes);
        if pending.split(|byte| *byte == b'\n').any(|line| line.len() > LONGEST_LINE) {
            return Err(wrong(format!("expected lines of at most {LONGEST_LINE} bytes, found a longer one")));
        }
        if let Some(end) = pending.iter().rposition(|byte| *byte == b'\n') {
            on_block(&pending[..end], part.total)?;
            pending.drain(..=end);
        }
        if offset >= part.total || part.bytes.is_empty() {
            break;
        }
    }
    if !pending.is_empty() {
        return Err(wrong("expected a line break at the end, found none: the file is truncated".to_owned()));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const LINE: &str = r#"{"key":"a_1","split":"train","scene":"a","frame":"1","tar":"train-000000.tar","offset":0,"size":1536,"members":{"flow.npy":{"offset":512,"size":3,"sha256":"9a129038d9a00aed0cf6a7ea059ca50a9a129038d9a00aed0cf6a7ea059ca50a"}},"flow":{"pixels":1,"occluded":0,"sum":1.0,"max":1.0},"flow_error":0.0}"#;

    fn read(text: impl AsRef<[u8]>) -> Result<Vec<Listing>, String> {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join(INDEX_NAME), text).unwrap();
        let mut pairs = Vec::new();
        let read = read_index(&Place::of(folder.path()), &["flow"], &mut |pair, _| pairs.push(pair));
        read.map(|()| pairs).map_err(|error| error.to_string())
    }

    #[test]
    fn lines_are_read() {
        let pairs = read(format!("{LINE}\n{}\n", LINE.replace("a_1", "a_2"))).unwrap();
        let [first, second] = &pairs[..] else { panic!("{pairs:?}") };
        assert_eq!((&*first.scene, &*first.frame, first.split), ("a", "1", Some(SceneSplit::Train)));
        assert_eq!((&*first.members.key, &*second.members.key), ("a_1", "a_2"));
        assert_eq!((first.members.spans[0].offset, first.members.spans[0].size), (512, 3));
        assert!(Arc::ptr_eq(&first.members.tar, &second.members.tar));
        let record: IndexRecord = serde_json::from_str(LINE).unwrap();
        assert_eq!(serde_json::to_string(&record).unwrap(), LINE);
    }

    #[test]
    fn an_index_is_read_in_parts() {
        let line = |number: u32| format!("{}\n", LINE.replace("a_1", &format!("a_{number}")));
        let pairs = 2 * CHUNK as u32 / LINE.len() as u32 + 10;
        let text: String = (0..pairs).map(line).collect();
        let found = read(&text).unwrap();
        assert_eq!(found.len(), pairs as usize);
        for (number, pair) in (0..).zip(&found) {
            assert_eq!(*pair.members.key, format!("a_{number}"));
        }
        let wrong = text.replace("\"a_20001\"", "\"../a\"");
        assert!(read(&wrong).unwrap_err().contains("line 20002: key: expected letters"));
        assert!(read(&text[..text.len() - 1]).unwrap_err().contains("truncated"));
        // As other programs may write text.
        let escaped = LINE.replace("\"a_1\"", "\"\\u0061_1\"").replace("flow.npy", "flow\\u002enpy");
        assert_eq!(&*read(format!("{escaped}\n\n")).unwrap()[0].members.key, "a_1");
    }

    #[test]
    fn wrong_lines_are_refused() {
        let cases = [
            (LINE.replace("\"a_1\"", "\"../a\""), "key: expected letters"),
            (LINE.replace("\"scene\":\"a\"", "\"scene\":\"a/b\""), "scene: expected letters"),
            (LINE.replace("\"frame\":\"1\"", "\"frame\":\"\""), "frame: expected letters"),
            (LINE.replace("train-000000.tar", "../../etc/passwd"), "tar: expected a name such as"),
            (LINE.replace("train-000000.tar", "/a.tar"), "tar: expected a name such as"),
            (LINE.replace("flow.npy", "flow./npy"), "such as flow.npy"),
            (LINE.replace("\"offset\":512", "\"offset\":18446744073709551615"), "inside a tar"),
            (LINE.replace("\"size\":3", "\"size\":99999999999"), "inside a tar"),
            (LINE.replace("\"sha256\":\"9a", "\"sha256\":\"zz"), "64 hexadecimal digits"),
            (LINE.replace("\"split\":\"train\"", "\"split\":\"\\u001b[2J\""), "line 1"),
            ("{".to_owned(), "line 1"),
            ("x".repeat(LONGEST_LINE + 1), "at most 65536 bytes"),
        ];
        for (text, said) in cases {
            let error = read(format!("{text}\n")).unwrap_err();
            assert!(error.contains(said) && error.contains(INDEX_NAME), "{said}: {error}");
            assert!(!error.contains(char::is_control), "{error:?}");
        }
        assert!(read(LINE).unwrap_err().contains("truncated"));
    }
}
