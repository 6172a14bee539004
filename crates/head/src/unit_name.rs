/// The FACS name of each unit (Ekman, Friesen and Hager 2002).
const NAMES: [(u8, &str); 22] = [
    (1, "inner brow raiser"),
    (2, "outer brow raiser"),
    (4, "brow lowerer"),
    (5, "upper lid raiser"),
    (6, "cheek raiser"),
    (7, "lid tightener"),
    (9, "nose wrinkler"),
    (10, "upper lip raiser"),
    (12, "lip corner puller"),
    (14, "dimpler"),
    (15, "lip corner depressor"),
    (16, "lower lip depressor"),
    (17, "chin raiser"),
    (18, "lip pucker"),
    (20, "lip stretcher"),
    (23, "lip tightener"),
    (24, "lip pressor"),
    (25, "lips part"),
    (26, "jaw drop"),
    (27, "mouth stretch"),
    (43, "eyes closed"),
    (45, "blink"),
];

/// The name of an action unit in FACS, such as `lip corner puller` for 12; `None` for one that no head of ours does.
pub fn unit_name(number: u8) -> Option<&'static str> {
    NAMES.iter().find(|(known, _)| *known == number).map(|(_, name)| *name)
}
