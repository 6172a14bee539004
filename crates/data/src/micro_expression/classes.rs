//! Class definitions: each class lists the emotions, action units or objective classes that it consists of.
//!
//! The usual definitions are in `classes/`, one TOML file each; users' own files have the same form.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use serde::Deserialize;
use srflow_core::{excerpt, is_unprintable};
use srflow_files::{FileKind, read_text};

use super::MicroExpressionError;

/// Built-in class sets: name, description, file.
pub const CLASS_SETS: [(&str, &str, &str); 13] = [
    (
        "3",
        "negative, positive, surprise, as in MEGC 2019 and the SRFlow paper",
        include_str!("classes/3.toml"),
    ),
    ("megc2019", "the same, with MEGC 2019's 442 clips: seven more of SMIC", include_str!("classes/3.toml")),
    (
        "casme2-5",
        "CASME II's happiness, disgust, repression, surprise, others",
        include_str!("classes/casme2-5.toml"),
    ),
    ("samm-4", "SAMM's anger, happiness, surprise, contempt", include_str!("classes/samm-4.toml")),
    ("samm-5", "SAMM's anger, happiness, surprise, contempt, other", include_str!("classes/samm-5.toml")),
    ("casme-4", "CASME's disgust, repression, surprise, tense", include_str!("classes/casme-4.toml")),
    ("casme3-4", "CAS(ME)³'s negative, positive, surprise, others", include_str!("classes/casme3-4.toml")),
    (
        "casme3-7",
        "CAS(ME)³'s disgust, surprise, others, fear, anger, sad, happy",
        include_str!("classes/casme3-7.toml"),
    ),
    ("mmew-4", "MMEW's happiness, surprise, disgust, others", include_str!("classes/mmew-4.toml")),
    (
        "4dme-5",
        "4DME's negative, positive, surprise, repression, others",
        include_str!("classes/4dme-5.toml"),
    ),
    (
        "dfme-7",
        "DFME's anger, contempt, disgust, fear, happiness, sadness, surprise",
        include_str!("classes/dfme-7.toml"),
    ),
    (
        "objective-5",
        "objective classes I to V of SAMM and CASME II, as in MEGC 2018",
        include_str!("classes/objective-5.toml"),
    ),
    ("objective-7", "all seven objective classes", include_str!("classes/objective-7.toml")),
];

const COUNT: std::ops::RangeInclusive<usize> = 2..=10;
const MAX_NAME: usize = 40;

/// A set of classes, in the order of their numbers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Classes {
    /// Name in [`CLASS_SETS`], or that of the file.
    title: String,
    names: Arc<[String]>,
    rules: Arc<[Rule]>,
}

/// The data of a clip that determines its class. Missing data is an empty text.
#[derive(Debug, Clone, Copy)]
pub(super) struct Coded<'a> {
    /// Kind of the dataset, e.g. `casme2`.
    pub kind: &'a str,
    /// The dataset's own label, e.g. `repression`.
    pub emotion: &'a str,
    /// Action units as coded, e.g. `R2+15`.
    pub action_units: &'a str,
    /// The published objective class, e.g. `3`.
    pub objective: &'a str,
}

/// One class of a file.
#[derive(Debug, Clone, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
struct Rule {
    name: String,
    /// Emotions in the dataset's terms; `samm:anger` matches SAMM only.
    #[serde(default)]
    emotions: Vec<String>,
    /// Combinations such as `6+12`, which match exactly; with `+*` at the end, other units may occur too.
    #[serde(default)]
    action_units: Vec<String>,
    /// Published objective classes, `1` to `7`.
    #[serde(default)]
    objective: Vec<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    class: Vec<Rule>,
}

impl Default for Classes {
    /// Negative, positive and surprise.
    fn default() -> Self {
        let (name, _, text) = CLASS_SETS[0];
        Self::parse(name, text).expect("a test parses every shipped file")
    }
}

impl Classes {
    /// The classes of a name in [`CLASS_SETS`], or of a TOML file.
    ///
    /// # Errors
    /// When it is neither, or the file does not hold 2 to 10 distinct classes.
    pub fn open(name_or_file: &str) -> Result<Self, MicroExpressionError> {
        if let Some((name, _, text)) = CLASS_SETS.iter().find(|(name, ..)| *name == name_or_file) {
            return Self::parse(name, text).map_err(|reason| wrong(Path::new(name), reason));
        }
        let path = Path::new(name_or_file);
        if !path.exists() && path.extension().is_none() {
            let known: Vec<&str> = CLASS_SETS.iter().map(|(name, ..)| *name).collect();
            let reason = format!("expected {} or the TOML file of your own classes", known.join(", "));
            return Err(wrong(path, reason));
        }
        let text = read_text(path, FileKind::Settings)?;
        Self::parse(name_or_file, &text).map_err(|reason| wrong(path, reason))
    }

    fn parse(title: &str, text: &str) -> Result<Self, String> {
        let File { class: rules } = toml::from_str(text)
            .map_err(|error| format!("expected classes as TOML: {}", excerpt(error.message())))?;
        if !COUNT.contains(&rules.len()) {
            return Err(format!(
                "expected {} to {} classes, found {}",
                COUNT.start(),
                COUNT.end(),
                rules.len()
            ));
        }
        let mut names: BTreeMap<String, &str> = BTreeMap::new();
        let mut seen: BTreeMap<String, &str> = BTreeMap::new();
        for rule in &rules {
            let name = &rule.name;
            let odd = name.trim() != name || name.is_empty() || name.contains(is_unprintable);
            if odd || name.chars().count() > MAX_NAME || name == "total" {
                return Err(format!(
                    "class `{}`: expected a name of 1 to {MAX_NAME} letters without spaces around it, other than `total`",
                    excerpt(name)
                ));
            }
            if names.insert(name.to_lowercase(), name).is_some() {
                return Err(format!("two classes have the name {name:?}; rename one"));
            }
            if let Some(units) = rule.action_units.iter().find(|units| pattern(units).is_none()) {
                return Err(format!(
                    "class {name:?}: expected action units like \"6+12\", or \"6+12+*\" where others may occur too; \
                     found `{}`",
                    excerpt(units)
                ));
            }
            let keys = rule.keys();
            if keys.is_empty() {
                return Err(format!(
                    "class {name:?}: expected a list `emotions`, `action_units` or `objective`"
                ));
            }
            for (shown, key) in keys {
                if let Some(other) = seen.insert(key, name).filter(|other| other != name) {
                    return Err(format!(
                        "{shown} is in the classes {other:?} and {name:?}; keep it in one of them"
                    ));
                }
            }
        }
        let names = rules.iter().map(|rule| rule.name.clone()).collect();
        Ok(Self { title: title.to_owned(), names, rules: rules.into() })
    }

    /// The name or path it was opened by.
    pub fn title(&self) -> &str {
        &self.title
    }

    /// The classes' names, by number.
    pub fn names(&self) -> &Arc<[String]> {
        &self.names
    }

    /// Whether these are negative, positive and surprise, whose published counts are known.
    pub fn are_default(&self) -> bool {
        self.title == CLASS_SETS[0].0
    }

    /// Whether these are those of MEGC 2019's list of clips.
    pub fn are_of_megc2019(&self) -> bool {
        self.title == CLASS_SETS[1].0
    }

    /// Whether any class uses published objective classes.
    pub(super) fn need_objective(&self) -> bool {
        self.rules.iter().any(|rule| !rule.objective.is_empty())
    }

    /// The class with this name (case-insensitive) or number.
    pub(super) fn named(&self, text: &str) -> Option<usize> {
        let is =
            |(number, name): (usize, &String)| name.eq_ignore_ascii_case(text) || text == number.to_string();
        self.names.iter().enumerate().position(is)
    }

    /// The first class that matches, if any.
    pub(super) fn of(&self, coded: &Coded) -> Option<usize> {
        let units = units(coded.action_units);
        self.rules.iter().position(|rule| rule.fits(coded, units.as_deref()))
    }
}

impl Rule {
    fn fits(&self, coded: &Coded, units: Option<&[u32]>) -> bool {
        let emotion = |text: &String| match text.split_once(':') {
            Some((kind, emotion)) => kind == coded.kind && same(emotion, coded.emotion),
            None => same(text, coded.emotion),
        };
        self.emotions.iter().any(emotion)
            || units.is_some_and(|units| {
                self.action_units.iter().filter_map(|text| pattern(text)).any(|pattern| pattern.fits(units))
            })
            || self.objective.iter().any(|text| same(text, coded.objective))
    }

    /// All entries of the class: as written, and in the form they are compared in.
    fn keys(&self) -> Vec<(String, String)> {
        let emotions = self
            .emotions
            .iter()
            .map(|text| (format!("emotion `{}`", excerpt(text)), text.trim().to_lowercase()));
        let units = self
            .action_units
            .iter()
            .map(|text| (format!("`{}`", excerpt(text)), format!("{:?}", pattern(text))));
        let objective = self.objective.iter().map(|text| {
            (format!("objective class `{}`", excerpt(text)), format!("objective {}", text.trim()))
        });
        emotions.chain(units).chain(objective).collect()
    }
}

fn same(listed: &str, found: &str) -> bool {
    !found.trim().is_empty() && listed.trim().eq_ignore_ascii_case(found.trim())
}

/// Action units of a rule: exactly these, or at least these.
#[derive(Debug, PartialEq, Eq)]
struct Pattern {
    units: Vec<u32>,
    others: bool,
}

impl Pattern {
    fn fits(&self, found: &[u32]) -> bool {
        match self.others {
            true => self.units.iter().all(|unit| found.contains(unit)),
            false => self.units == found,
        }
    }
}

fn pattern(text: &str) -> Option<Pattern> {
    let text = text.trim();
    let (listed, others) = match text.strip_suffix("+*") {
        Some(listed) => (listed, true),
        None => (text, false),
    };
    let units = units(listed)?;
    (!units.is_empty()).then_some(Pattern { units, others })
}

/// The numbers of coded action units in ascending order, without side, asymmetry and intensity: `L14C+A7` is 7 and 14, as is
/// `ref(7B)+14`. `None` for a choice (`L12 or L14`) or a doubt (`?`). Words such as `soft focus` are ignored.
fn units(coded: &str) -> Option<Vec<u32>> {
    let mut units = Vec::new();
    for part in coded.split('+').map(str::trim).filter(|part| !part.is_empty()) {
        if part.contains('?') {
            return None;
        }
        if !part.contains(|c: char| c.is_ascii_digit()) {
            continue;
        }
        let part = part.strip_prefix("ref(").and_then(|part| part.strip_suffix(')')).unwrap_or(part);
        // Action units, action descriptors, movements; else unilateral left and right, asymmetric, top, bottom.
        let bare =
            ["AU", "AD", "M", "L", "R", "A", "T", "B"].iter().find_map(|prefix| part.strip_prefix(prefix));
        let bare = bare.unwrap_or(part);
        let end = bare.find(|c: char| !c.is_ascii_digit()).unwrap_or(bare.len());
        let (number, intensity) = bare.split_at(end);
        if !intensity.chars().all(|c| matches!(c, 'A'..='E' | '/')) {
            return None;
        }
        units.push(number.parse().ok()?);
    }
    units.sort_unstable();
    units.dedup();
    Some(units)
}

fn wrong(path: &Path, reason: String) -> MicroExpressionError {
    MicroExpressionError::Table { path: path.to_owned(), reason }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_shipped_file_is_read() {
        for (name, _, _) in CLASS_SETS {
            let classes = Classes::open(name).unwrap();
            assert_eq!((classes.title(), classes.are_default()), (name, name == "3"));
        }
        assert_eq!(*Classes::default().names().to_vec(), ["negative", "positive", "surprise"]);
    }

    #[test]
    fn action_units_lose_side_and_intensity() {
        for (coded, expected) in [
            ("4+7", Some(vec![4, 7])),
            ("4", Some(vec![4])),
            ("L14C+A7", Some(vec![7, 14])),
            ("R2+15", Some(vec![2, 15])),
            ("10A/B", Some(vec![10])),
            ("ref(7B)+43C", Some(vec![7, 43])),
            ("R14+17+soft focus", Some(vec![14, 17])),
            ("L1+L1", Some(vec![1])),
            ("R4+AD38+M58", Some(vec![4, 38, 58])),
            ("AU4+AU7(k)", None),
            ("", Some(vec![])),
            ("?", None),
            ("(R6 or R12) + R15", None),
            ("L12 or L14", None),
        ] {
            assert_eq!(units(coded), expected, "{coded}");
        }
    }

    #[test]
    fn the_first_class_that_fits_counts() {
        let text = r#"
            [[class]]
            name = "smile"
            emotions = ["samm:happiness"]
            action_units = ["12", "6+12"]
            [[class]]
            name = "brows"
            action_units = ["4+*"]
            [[class]]
            name = "third"
            emotions = ["Disgust"]
            objective = ["3"]
        "#;
        let classes = Classes::parse("mine", text).unwrap();
        let of = |kind, emotion, action_units, objective| {
            classes.of(&Coded { kind, emotion, action_units, objective })
        };
        assert_eq!(of("samm", "Happiness", "", ""), Some(0));
        assert_eq!(of("casme2", "happiness", "", ""), None);
        assert_eq!(of("casme2", "happiness", "L6+12", ""), Some(0));
        assert_eq!(of("casme2", "", "4+7", ""), Some(1));
        assert_eq!(of("casme2", "disgust", "4+7", ""), Some(1));
        assert_eq!(of("casme2", "disgust", "9", ""), Some(2));
        assert_eq!(of("samm", "other", "17", "3"), Some(2));
        assert_eq!(of("samm", "", "", ""), None);
        assert_eq!(
            (classes.named("Brows"), classes.named("2"), classes.named("3")),
            (Some(1), Some(2), None)
        );
    }

    #[test]
    fn wrong_files_say_why() {
        let class = |name: &str, rule: &str| format!("[[class]]\nname = {name:?}\n{rule}\n");
        let happy = class("a", "emotions = [\"happiness\"]");
        for (text, expected) in [
            (happy.clone(), "expected 2 to 10 classes, found 1"),
            (happy.repeat(2), "two classes have the name \"a\""),
            (
                happy.clone() + &class("b", "emotions = [\"Happiness\"]"),
                "`Happiness` is in the classes \"a\" and \"b\"",
            ),
            (happy.clone() + &class("b", "action_units = [\"6 and 12\"]"), "found `6 and 12`"),
            (happy.clone() + &class("b", ""), "expected a list `emotions`"),
            (happy.clone() + &class("", "objective = [\"1\"]"), "expected a name"),
            (happy + "emotion = []", "unknown field `emotion`"),
            ("classes = 3".to_owned(), "expected classes as TOML"),
        ] {
            let error = Classes::parse("mine", &text).unwrap_err();
            assert!(error.contains(expected), "{error}");
        }
        let unknown = Classes::open("casme-9").unwrap_err().to_string();
        assert!(unknown.contains("casme-9: expected 3, megc2019, casme2-5, samm-4"), "{unknown}");
    }
}
