//! Datasets packed as WebDataset tars, to publish and to stream.
//!
//! ```text
//! README.md                dataset card: front matter of Hugging Face, pictures, statistics
//! croissant.json           the same for programs (Croissant 1.1)
//! pack.json                arguments of the packing, and dataset.json of the dataset
//! index.jsonl              a line for each pair: where its members are, their SHA-256, statistics of the flow
//! tars.jsonl               a line for each tar: its size, SHA-256 and number of pairs; written last
//! SHA256SUMS               SHA-256 of every other file, as `sha256sum -c` checks them
//! images/scene-0003_00000.png
//! train-000000.tar ...     pairs of each split; val-000000.tar ..., test-000000.tar ...
//! ```
//!
//! Members of a pair are named `KEY.FIELD.ENDING`, such as `scene-0003_00000.flow.npy`; see [`FIELDS`]. They are adjacent, sorted by name,
//! and the same for every pair.

mod card;
mod croissant;
mod index;
mod pattern;
mod place;
mod source;
mod tar;
mod tar_size;
mod ustar;
mod writer;

pub use writer::{PackError, PackEvent, PackReport, PackRequest, PackSettings, PackedFlow, pack};

pub(crate) use index::{INDEX_NAME, Listing, read_index};
pub(crate) use pattern::expand;
pub(crate) use place::Place;
pub use tar::Member;
pub(crate) use tar::{Contents, SampleMembers, scan};
pub use tar_size::TarSize;

/// What a member may contain, by the first word of its extension, with its meaning.
pub const FIELDS: [(&str, &str); 10] = [
    ("alpha", "alpha of frame 1: 8-bit grey"),
    ("depth", "depth of frame 1: 16-bit grey in tenths of a millimetre, 0 where there is none"),
    (
        "flow",
        "flow from frame 1 to frame 2 in pixels: H x W x 2, u to the right and v down, at frame 1's pixels",
    ),
    ("flow_backward", "flow from frame 2 to frame 1, at frame 2's pixels"),
    ("frame1", "first frame: 8-bit sRGB"),
    ("frame2", "second frame: 8-bit sRGB"),
    ("mask", "255 on the head in frame 1, else 0"),
    ("meta", "cameras, motion and action units of both frames"),
    ("occlusion", "255 where a pixel of frame 1 is not visible in frame 2, else 0"),
    ("regions", "part of the head in frame 1: 8-bit grey, 0 to 5"),
];

/// Whether a text is a plain name: letters, digits, `-` and `_`, so that it can be a part of any path or message.
pub(crate) fn is_plain(name: &str) -> bool {
    !name.is_empty()
        && name.len() <= 200
        && name.chars().all(|c| c.is_ascii_alphanumeric() || matches!(c, '-' | '_'))
}
