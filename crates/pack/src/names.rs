//! Names of members: `KEY.FIELD.ENDING`.

/// What a member may contain, by the first word of its extension, with its meaning.
const FIELDS: [(&str, &str); 13] = [
    ("alpha", "alpha of frame 1: 8-bit grey"),
    ("depth", "depth of frame 1: 16-bit grey in tenths of a millimetre, 0 where there is none"),
    (
        "flow",
        "flow from frame 1 to frame 2 in pixels: H x W x 2, u to the right and v down, at frame 1's pixels",
    ),
    ("flow_backward", "flow from frame 2 to frame 1, at frame 2's pixels"),
    ("expression_flow", "what the face adds to head_flow: the two add up to flow"),
    ("frame1", "first frame: 8-bit sRGB"),
    ("frame2", "second frame: 8-bit sRGB"),
    ("head_flow", "flow with the head moving alone, its face as in frame 1"),
    ("mask", "255 on the head in frame 1, else 0"),
    ("meta", "cameras, motion and action units of both frames"),
    ("occlusion", "255 where a pixel of frame 1 is not visible in frame 2, else 0"),
    ("regions", "part of the head in frame 1: 8-bit grey, 0 to 5"),
    (
        "shading_change",
        "change of brightness from frame 1 to frame 2 that is no motion: 16-bit grey, 32768 and 128 times the change in levels of 255",
    ),
];

/// `flow` of `flow.npy`.
pub(crate) fn field_of(ending: &str) -> &str {
    ending.split('.').next().unwrap_or_default()
}

/// The meaning of the members with this ending; empty for other fields.
pub(crate) fn about_field(ending: &str) -> &'static str {
    FIELDS.iter().find(|(name, _)| *name == field_of(ending)).map_or("", |(_, about)| about)
}

/// Whether a text is a plain name: letters, digits, `-` and `_`, so that it can be a part of any path or message.
pub(crate) fn is_plain(name: &str) -> bool {
    !name.is_empty()
        && name.len() <= 200
        && name.chars().all(|c| c.is_ascii_alphanumeric() || matches!(c, '-' | '_'))
}
