//! Numbers of frames in the names of their files: one rule for all folders of frames.
//!
//! - The number of a frame is the last one that differs from frame to frame: 46 in `img46_200fps.jpg`.
//! - `img5 (1).jpg`, `img5 - Copy.jpg`, `img5 2.jpg` and the like are copies of `img5.jpg` and are left out, unless most names are of this
//!   kind: Windows numbers files as `img (1).jpg`.
//! - `-3` is negative in `-3.png` and `t_-3.png`, and in `t-3.png` beside `t0.png`.
//! - Times, such as `1305031102.175304.png` or `1403636579763555584.png`, order the frames but do not count them.

use std::cmp::Reverse;
use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

use srflow_core::{excerpt, printable};

use crate::listing;

/// The frames of a folder.
pub struct FrameNames {
    files: Vec<PathBuf>,
    names: Vec<Name>,
    /// Whether the names are decimal fractions.
    decimals: bool,
    copies: Vec<(PathBuf, String)>,
}

impl FrameNames {
    /// For files in natural order.
    pub fn new(files: Vec<PathBuf>) -> Self {
        let stems: Vec<String> = files.iter().map(|file| listing::stem(file)).collect();
        let originals = Originals::new(&stems);
        let (mut kept, mut names, mut copies) = (Vec::new(), Vec::new(), Vec::new());
        for (file, stem) in files.into_iter().zip(&stems) {
            match originals.of(stem) {
                Original::Present(original) => copies.push((file, original.to_owned())),
                Original::Absent(stem) => {
                    kept.push(file);
                    names.push(Name::new(stem));
                }
            }
        }
        find_signs(&mut names);
        let mut frames = Self { files: kept, names, decimals: false, copies };
        frames.order();
        frames
    }

    /// The files in the order of their frames, without copies.
    pub fn files(&self) -> &[PathBuf] {
        &self.files
    }

    /// The copies that are left out, each with the name of its original.
    pub fn copies(&self) -> impl Iterator<Item = (&Path, &str)> {
        self.copies.iter().map(|(file, original)| (file.as_path(), original.as_str()))
    }

    /// A note for each copy.
    pub fn notes(&self) -> impl Iterator<Item = String> {
        self.copies().map(|(file, original)| {
            let (file, original) = (printable(&file.to_string_lossy()).to_string(), excerpt(original));
            format!("{file}: left out, since its name is that of a copy of {original}")
        })
    }

    /// The number of each frame; `None` where the name has none.
    pub fn numbers(&self) -> Vec<Option<i64>> {
        let mut numbers = vec![None; self.names.len()];
        for group in self.groups() {
            let Some(column) = self.counter(&group) else { continue };
            for at in group {
                numbers[at] = Some(self.names[at].numbers[column].value);
            }
        }
        numbers
    }

    /// The first two frames whose names differ in nothing but leading zeros, or in the extension.
    pub fn twice(&self) -> Option<[&Path; 2]> {
        let mut seen = HashMap::new();
        self.names.iter().enumerate().find_map(|(at, name)| {
            seen.insert((&name.texts, name.values()), at).map(|other| self.pair(other, at))
        })
    }

    /// The first two neighbours between which a frame is missing, as in `f_1`, `f_2`, `f_4`. `None` unless all names are the same text
    /// around one number that counts the frames.
    pub fn gap(&self) -> Option<[&Path; 2]> {
        const LEAST_TICKS: u64 = 10;
        let groups = self.groups();
        let [group] = &groups[..] else { return None };
        let mut varying =
            (0..self.names[group[0]].numbers.len()).filter(|column| self.varies(group, *column));
        let (Some(column), None) = (varying.next(), varying.next()) else { return None };
        if self.decimals || self.names.iter().any(|name| name.is_time(column)) {
            return None;
        }
        let values: Vec<i64> = self.names.iter().map(|name| name.numbers[column].value).collect();
        let steps: Vec<u64> = values.windows(2).map(|pair| pair[0].abs_diff(pair[1])).collect();
        let step = *steps.iter().min()?;
        // Times differ by about the same, and not by multiples of it.
        if step >= LEAST_TICKS && steps.iter().any(|other| !other.is_multiple_of(step)) {
            return None;
        }
        let at = steps.iter().position(|other| *other != step)?;
        Some(self.pair(at, at + 1))
    }

    fn pair(&self, first: usize, second: usize) -> [&Path; 2] {
        [&self.files[first], &self.files[second]]
    }

    /// Positions of the names that are the same text around numbers.
    fn groups(&self) -> Vec<Vec<usize>> {
        let mut groups: Vec<Vec<usize>> = Vec::new();
        let mut known = HashMap::new();
        for (at, name) in self.names.iter().enumerate() {
            let group = *known.entry(&name.texts).or_insert(groups.len());
            if group == groups.len() {
                groups.push(Vec::new());
            }
            groups[group].push(at);
        }
        groups
    }

    fn varies(&self, group: &[usize], column: usize) -> bool {
        let value = |at: &usize| self.names[*at].numbers[column].value;
        group.iter().any(|at| value(at) != value(&group[0]))
    }

    /// Which of the numbers in the names of a group counts the frames: one that no two frames share, or else one that varies.
    fn counter(&self, group: &[usize]) -> Option<usize> {
        let columns = self.names[group[0]].numbers.len();
        let last = columns.checked_sub(1)?;
        let values = |column: usize| group.iter().map(move |at| self.names[*at].numbers[column].value);
        let tells_apart = |column: &usize| values(*column).collect::<HashSet<_>>().len() == group.len();
        // A time beside a number of the frame spans more.
        let span = |column: &usize| {
            let (least, most) = (values(*column).min(), values(*column).max());
            (least.zip(most).map(|(least, most)| most.abs_diff(least)), Reverse(*column))
        };
        if group.len() == 1 {
            return Some(last);
        }
        let counter = (0..columns).filter(tells_apart).min_by_key(span);
        counter.or_else(|| (0..columns).rev().find(|column| self.varies(group, *column))).or(Some(last))
    }

    /// Sorts negative numbers and decimal fractions, which natural order does not know.
    fn order(&mut self) {
        let groups = self.groups();
        let [group] = &groups[..] else { return };
        self.decimals = self.are_decimals(group);
        if self.decimals {
            self.names.iter_mut().for_each(Name::align_fractions);
        } else if !self.names.iter().any(Name::is_negative) {
            return;
        }
        let (files, names) = (std::mem::take(&mut self.files), std::mem::take(&mut self.names));
        let mut both: Vec<(PathBuf, Name)> = files.into_iter().zip(names).collect();
        both.sort_by_key(|(_, name)| name.values());
        (self.files, self.names) = both.into_iter().unzip();
    }

    /// Whether the names of a group hold decimal fractions of different lengths: seconds since 1970, or with leading zeros. In others, such
    /// as `1.9` and `1.10`, the second number counts.
    fn are_decimals(&self, group: &[usize]) -> bool {
        let Some(point) = self.names[group[0]].point() else { return false };
        let parts =
            || group.iter().map(|at| (&self.names[*at].numbers[point - 1], &self.names[*at].numbers[point]));
        let length = self.names[group[0]].numbers[point].digits;
        let is_fraction =
            parts().any(|(whole, fraction)| whole.value >= LEAST_TIME || fraction.has_leading_zero());
        is_fraction && parts().any(|(_, fraction)| fraction.digits != length)
    }
}

/// Seconds since 1970 that no number of a frame reaches.
const LEAST_TIME: i64 = 100_000_000;

/// A name as text and numbers in turn: the texts are one more.
struct Name {
    texts: Vec<String>,
    numbers: Vec<Number>,
}

#[derive(Clone, Copy)]
struct Number {
    value: i64,
    digits: usize,
}

impl Number {
    fn has_leading_zero(&self) -> bool {
        self.digits > 1 && self.value.checked_ilog10().map_or(1, |log| log as usize + 1) < self.digits
    }
}

impl Name {
    fn new(stem: &str) -> Self {
        let mut name = Self { texts: vec![String::new()], numbers: Vec::new() };
        let mut rest = stem;
        while let Some(first) = rest.chars().next() {
            let digits = first.is_ascii_digit();
            let end = rest.find(|c: char| c.is_ascii_digit() != digits).unwrap_or(rest.len());
            let (part, after) = rest.split_at(end);
            rest = after;
            match part.parse::<i64>() {
                Ok(value) if digits => {
                    name.numbers.push(Number { value, digits: part.len() });
                    name.texts.push(String::new());
                }
                _ => name.texts.last_mut().expect("one more than the numbers").push_str(part),
            }
        }
        name
    }

    fn values(&self) -> Vec<i64> {
        self.numbers.iter().map(|number| number.value).collect()
    }

    fn is_negative(&self) -> bool {
        self.numbers.iter().any(|number| number.value < 0)
    }

    /// Whether a number, or the one that it is a fraction of, is a time.
    fn is_time(&self, number: usize) -> bool {
        let is_time = |number: usize| self.numbers[number].value >= LEAST_TIME;
        is_time(number) || (number > 0 && self.texts[number] == "." && is_time(number - 1))
    }

    /// The number after the only decimal point.
    fn point(&self) -> Option<usize> {
        let mut points = (1..self.numbers.len()).filter(|number| self.texts[*number] == ".");
        points.next().filter(|_| points.next().is_none())
    }

    /// Fractions in units of 1e-18.
    fn align_fractions(&mut self) {
        if let Some(point) = self.point() {
            let fraction = &mut self.numbers[point];
            for _ in fraction.digits..18 {
                fraction.value = fraction.value.saturating_mul(10);
            }
        }
    }
}

/// Takes hyphens as signs where they are.
fn find_signs(names: &mut [Name]) {
    const BEFORE_A_SIGN: [char; 7] = ['_', '=', '(', '[', ',', '.', '+'];
    let present: HashSet<Vec<String>> = names.iter().map(|name| name.texts.clone()).collect();
    for name in names {
        for at in 0..name.numbers.len() {
            let Some(before) = name.texts[at].strip_suffix('-').map(str::to_owned) else { continue };
            let mut unsigned = name.texts.clone();
            unsigned[at].clone_from(&before);
            let apart = (at == 0 && before.is_empty()) || before.ends_with(BEFORE_A_SIGN);
            if present.contains(&unsigned) || (apart && !name.numbers[at].has_leading_zero()) {
                name.texts = unsigned;
                name.numbers[at].value = -name.numbers[at].value;
            }
        }
    }
}

/// What programs append to the name of a copy.
const COPY: [&str; 8] = ["copy", "kopie", "copie", "copia", "cópia", "kopia", "副本", "コピー"];
/// What they put before it.
const COPY_OF: [&str; 4] = ["copy of ", "kopie von ", "copie de ", "copia de "];

enum Original<'a> {
    /// The file of this name is a copy of one that is in the folder.
    Present(&'a str),
    /// It is not; the name without the mark of a copy.
    Absent(&'a str),
}

/// Which names of a folder are copies of which.
struct Originals<'a> {
    stems: HashSet<&'a str>,
    /// The texts of names without marks, and how many have them.
    unmarked: HashMap<Vec<String>, usize>,
    /// How many names are one name and a number in parentheses.
    numbered: HashMap<&'a str, usize>,
}

impl<'a> Originals<'a> {
    fn new(stems: &'a [String]) -> Self {
        let (mut unmarked, mut numbered) = (HashMap::new(), HashMap::new());
        for stem in stems {
            match without_mark(stem) {
                Some((original, Mark::Number)) => *numbered.entry(original).or_default() += 1,
                Some((_, Mark::Word)) => {}
                _ => *unmarked.entry(Name::new(stem).texts).or_default() += 1,
            }
        }
        Self { stems: stems.iter().map(String::as_str).collect(), unmarked, numbered }
    }

    fn of(&self, stem: &'a str) -> Original<'a> {
        let Some((original, mark)) = without_mark(stem) else { return Original::Absent(stem) };
        let siblings = self.unmarked.get(&Name::new(original).texts).copied().unwrap_or_default();
        let counts = match mark {
            Mark::Word => false,
            Mark::Number => self.numbered.get(original).is_some_and(|numbered| *numbered > siblings),
            Mark::Bare => !self.stems.contains(original) || siblings < 2,
        };
        match counts {
            true => Original::Absent(stem),
            false if self.stems.contains(original) => Original::Present(original),
            false => Original::Absent(original),
        }
    }
}

#[derive(Clone, Copy, PartialEq)]
enum Mark {
    /// ` - Copy`
    Word,
    /// ` (1)`
    Number,
    /// ` 2`
    Bare,
}

/// A name with a number in it and the mark of a copy, without the mark.
fn without_mark(stem: &str) -> Option<(&str, Mark)> {
    let found = marked(stem)?;
    found.0.contains(|c: char| c.is_ascii_digit()).then_some(found)
}

fn marked(stem: &str) -> Option<(&str, Mark)> {
    let prefix = |word: &&str| stem.get(..word.len()).is_some_and(|start| start.eq_ignore_ascii_case(word));
    if let Some(word) = COPY_OF.iter().find(|word| prefix(word)) {
        return Some((&stem[word.len()..], Mark::Word));
    }
    if let Some(original) = without_word(stem) {
        return Some((original, Mark::Word));
    }
    let in_parentheses = stem.strip_suffix(')').and_then(|inner| without_digits(inner)?.strip_suffix('('));
    let (before, mark) = match in_parentheses {
        Some(before) => (before, Mark::Number),
        None => (without_digits(stem)?.strip_suffix(' ')?, Mark::Bare),
    };
    let before = before.trim_end();
    Some(without_word(before).map_or((before, mark), |original| (original, Mark::Word)))
}

fn without_digits(text: &str) -> Option<&str> {
    let start = text.trim_end_matches(|c: char| c.is_ascii_digit());
    (start.len() < text.len()).then_some(start)
}

/// `img5` of `img5 - Copy`, `img5 copy` and `img5_copy`.
fn without_word(stem: &str) -> Option<&str> {
    const BETWEEN: [char; 3] = [' ', '-', '_'];
    COPY.iter().find_map(|word| {
        let (start, end) = stem.split_at_checked(stem.len().checked_sub(word.len())?)?;
        (end.eq_ignore_ascii_case(word) && start.ends_with(BETWEEN)).then(|| start.trim_end_matches(BETWEEN))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(names: &[&str]) -> FrameNames {
        let mut files: Vec<String> = names.iter().map(|name| format!("{name}.png")).collect();
        files.sort_by(|a, b| listing::natural_order(a, b));
        FrameNames::new(files.into_iter().map(PathBuf::from).collect())
    }

    fn numbers(of: &[&str]) -> Vec<Option<i64>> {
        names(of).numbers()
    }

    fn stems(frames: &FrameNames) -> Vec<String> {
        frames.files().iter().map(|file| listing::stem(file)).collect()
    }

    fn gap(of: &[&str]) -> Option<[String; 2]> {
        names(of).gap().map(|pair| pair.map(listing::stem))
    }

    #[test]
    fn the_number_of_a_frame_is_the_one_that_differs() {
        assert_eq!(numbers(&["img46", "img047", "img48"]), [Some(46), Some(47), Some(48)]);
        assert_eq!(numbers(&["img46_200fps", "img47_200fps"]), [Some(46), Some(47)]);
        assert_eq!(numbers(&["s01_0001_1305031102175", "s01_0002_1305031102208"]), [Some(1), Some(2)]);
        assert_eq!(numbers(&["006_05562"]), [Some(5562)]);
        assert_eq!(numbers(&["é12é", "none", "x99999999999999999999x"]), [None, None, Some(12)]);
        assert_eq!(numbers(&["1", "01", "2"]), [Some(1), Some(1), Some(2)]);
        assert_eq!(numbers(&["a_200fps", "b_200fps"]), [Some(200), Some(200)]);
    }

    #[test]
    fn copies_are_left_out() {
        for copy in [
            "img5 (1)",
            "img5(2)",
            "img5 - Copy",
            "img5 - Copy (2)",
            "img5 copy 2",
            "img5 2",
            "Copy of img5",
            "img5 - 副本",
        ] {
            let frames = names(&["img4", "img5", copy, "img6"]);
            assert_eq!(stems(&frames), ["img4", "img5", "img6"], "{copy}");
            assert_eq!(
                frames.notes().collect::<Vec<_>>(),
                [format!("{copy}.png: left out, since its name is that of a copy of img5")]
            );
        }
        // The copy of a file that is gone has the frame's number.
        for copy in ["img5 (1)", "img5 - Copy"] {
            assert_eq!(numbers(&["img4", copy, "img6"]), [Some(4), Some(5), Some(6)], "{copy}");
        }
        // Windows numbers files in this way.
        assert_eq!(numbers(&["img (1)", "img (2)", "img (3)"]), [Some(1), Some(2), Some(3)]);
        assert_eq!(numbers(&["clip01", "clip01 (1)", "clip01 (2)"]).len(), 3);
        assert_eq!(numbers(&["clip01 (1)", "clip01 (2)", "clip01 (10)"]), [Some(1), Some(2), Some(10)]);
        assert_eq!(numbers(&["frame 1", "frame 2"]), [Some(1), Some(2)]);
        assert_eq!(numbers(&["take 1 1", "take 1 2"]), [Some(1), Some(2)]);
    }

    #[test]
    fn negative_numbers_and_fractions_are_in_order() {
        for (given, ordered) in [
            (&["-2", "-1", "0", "1"], ["-2", "-1", "0", "1"]),
            (&["t-1", "t-10", "t0", "t1"], ["t-10", "t-1", "t0", "t1"]),
            (&["0.5", "0.033", "0.1", "0.066"], ["0.033", "0.066", "0.1", "0.5"]),
            (
                &["1305031102.5", "1305031102.21", "1305031103.1", "1305031102.175"],
                ["1305031102.175", "1305031102.21", "1305031102.5", "1305031103.1"],
            ),
            (&["1.9", "1.10", "1.1", "1.2"], ["1.1", "1.2", "1.9", "1.10"]),
            (&["f-01", "f-03", "f-04", "f-10"], ["f-01", "f-03", "f-04", "f-10"]),
        ] {
            assert_eq!(stems(&names(given)), ordered);
        }
        assert_eq!(numbers(&["t-2", "t-1", "t0"]), [Some(-2), Some(-1), Some(0)]);
    }

    #[test]
    fn frames_are_missing_only_where_numbers_count_them() {
        let some = |a: &str, b: &str| Some([a.to_owned(), b.to_owned()]);
        assert_eq!(gap(&["f1", "f2", "f4"]), some("f2", "f4"));
        assert_eq!(gap(&["f1_200fps", "f2_200fps", "f4_200fps"]), some("f2_200fps", "f4_200fps"));
        assert_eq!(gap(&["f000", "f040", "f080", "f160"]), some("f080", "f160"));
        assert_eq!(gap(&["-2", "-1", "1"]), some("-1", "1"));
        for whole in [
            &["a_08_l", "a_10_l", "a_12_l"][..],
            &["a9", "a10", "a11"],
            &["onset", "apex", "f7"],
            &["a1", "b3", "c9"],
            &["1305031102.175304", "1305031102.211214", "1305031102.243211"],
            &["1403636579763555584", "1403636579813555456", "1403636579913555456"],
            &["f033", "f067", "f100", "f200"],
            &["0.0", "0.033", "0.1"],
        ] {
            assert_eq!(gap(whole), None, "{whole:?}");
        }
    }

    #[test]
    fn the_same_number_twice_is_found() {
        let twice = |of: &[&str]| names(of).twice().map(|pair| pair.map(listing::stem));
        assert_eq!(twice(&["1", "01", "2"]), Some(["01".to_owned(), "1".to_owned()]));
        assert_eq!(twice(&["a1", "b1", "a2"]), None);
        assert_eq!(twice(&["0.1", "0.01"]), None);
    }
}
