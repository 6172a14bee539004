//! `.ksplat` files of GaussianSplats3D (mkkellogg/GaussianSplats3D, `src/loaders/SplatBuffer.js`), little-endian: a header of 4096 bytes, a
//! header of 1024 bytes for each section, and the sections.
//!
//! | bytes of the header | are |
//! |---|---|
//! | 0, 1 | version: 0 and 1 |
//! | 4 | sections (`u32`) |
//! | 16 | Gaussians (`u32`) |
//! | 20 | level of compression (`u16`) |
//! | 36, 40 | least and largest coefficient of level 2 (`f32`) |
//!
//! | bytes of a section's header | are |
//! |---|---|
//! | 0, 4 | Gaussians, and how many there is room for (`u32`) |
//! | 8, 12 | Gaussians in a full bucket, and buckets (`u32`) |
//! | 16, 20 | side of a bucket (`f32`), bytes of its centre (`u16`) |
//! | 24 | steps of half the side (`u32`) |
//! | 32, 36 | full buckets, and others (`u32`), which come after the full ones |
//! | 40 | degree of the spherical harmonics (`u16`) |
//!
//! A section is the numbers of Gaussians in the buckets that are not full (`u32`), the buckets' centres, and one record for each Gaussian:
//! position, scales and quaternion (w, x, y, z) as `f32` in level 0, else positions as `u16` steps from a corner of the bucket and the
//! others as `f16`; colour and opacity as `u8`; and the harmonics degree by degree and in it channel by channel, as `f32`, `f16` or `u8`.

use std::path::Path;

use glam::Vec3;
use half::f16;
use srflow_files::{FileError, FileKind, FileProblem, read_file};

use super::{Invisible, problem, room_for, unit_rotation};
use crate::{Gaussians, SH_0, sh};

const HEADER: usize = 4096;
const SECTION_HEADER: usize = 1024;
/// Limits of the coefficients of level 2 in files that name none.
const DEFAULT_LIMIT: f32 = 1.5;
/// Steps of half a bucket's side in files that name none, by level.
const DEFAULT_STEPS: [u32; 3] = [1, 32767, 32767];

pub(super) fn read(path: &Path) -> Result<Gaussians, FileError> {
    let bytes = read_file(path, FileKind::Splats)?;
    let mut invisible = Invisible::default();
    let gaussians = decode(&bytes, &mut invisible).map_err(|problem| problem.in_file(path))?;
    invisible.note(path, &gaussians);
    Ok(gaussians)
}

/// The bytes from one on, which ends where the file or a part of it does.
#[derive(Clone, Copy)]
struct Part<'a>(&'a [u8]);

impl<'a> Part<'a> {
    fn array<const N: usize>(self, at: usize) -> Option<[u8; N]> {
        self.0.get(at..)?.first_chunk().copied()
    }

    fn u16(self, at: usize) -> Option<u16> {
        self.array(at).map(u16::from_le_bytes)
    }

    fn u32(self, at: usize) -> Option<u32> {
        self.array(at).map(u32::from_le_bytes)
    }

    fn f32(self, at: usize) -> Option<f32> {
        self.array(at).map(f32::from_le_bytes)
    }

    /// Number `index` of those that start at byte `at`, in the width of a level.
    fn number(self, at: usize, index: usize, level: usize) -> Option<f32> {
        if level == 0 {
            self.f32(at + 4 * index)
        } else {
            self.u16(at + 2 * index).map(|bits| f16::from_bits(bits).to_f32())
        }
    }

    /// The first `count` items of this many bytes each, and what follows.
    fn split(self, count: u64, bytes: u64) -> Option<(Self, Self)> {
        let at = usize::try_from(count.checked_mul(bytes)?).ok()?;
        let (first, rest) = self.0.split_at_checked(at)?;
        Some((Self(first), Self(rest)))
    }
}

struct Level {
    number: usize,
    /// The least coefficient of level 2 and the distance to the largest.
    harmonics: [f32; 2],
}

impl Level {
    fn record_bytes(&self, sh_degree: usize) -> usize {
        let harmonic = [4, 2, 1][self.number];
        self.harmonics_at() + 3 * (sh::coefficients(sh_degree) - 1) * harmonic
    }

    /// Position, scales and rotation.
    fn colors_at(&self) -> usize {
        if self.number == 0 { 40 } else { 20 }
    }

    fn harmonics_at(&self) -> usize {
        self.colors_at() + 4
    }

    /// Coefficients of degree 1 and above, in our order.
    fn harmonics(&self, record: Part, sh_degree: usize) -> Option<Vec<[f32; 3]>> {
        let mut all = Vec::with_capacity(sh::coefficients(sh_degree) - 1);
        let mut before = 0;
        for degree in 1..=sh_degree {
            let width = 2 * degree + 1;
            for coefficient in 0..width {
                let mut channels = [0.0; 3];
                for (channel, value) in channels.iter_mut().enumerate() {
                    let index = before + channel * width + coefficient;
                    *value = if self.number == 2 {
                        let [byte] = record.array(self.harmonics_at() + index)?;
                        self.harmonics[0] + f32::from(byte) / 255.0 * self.harmonics[1]
                    } else {
                        record.number(self.harmonics_at(), index, self.number)?
                    };
                }
                all.push(channels);
            }
            before += 3 * width;
        }
        Some(all)
    }
}

struct Section {
    count: u32,
    room: u32,
    in_full: u32,
    buckets: u32,
    half_side: f32,
    center_bytes: u16,
    steps: u32,
    full: u32,
    others: u32,
    sh_degree: usize,
}

impl Section {
    fn parse(header: Part, level: usize) -> Option<Self> {
        Some(Self {
            count: header.u32(0)?,
            room: header.u32(4)?,
            in_full: header.u32(8)?,
            buckets: header.u32(12)?,
            half_side: header.f32(16)? / 2.0,
            center_bytes: header.u16(20)?,
            steps: Some(header.u32(24)?).filter(|steps| *steps > 0).unwrap_or(DEFAULT_STEPS[level]),
            full: header.u32(32)?,
            others: header.u32(36)?,
            sh_degree: header.u16(40)?.into(),
        })
    }
}

pub(super) fn decode(bytes: &[u8], invisible: &mut Invisible) -> Result<Gaussians, FileProblem> {
    let truncated =
        || problem("file size", "as many bytes as the headers claim", format!("{} bytes", bytes.len()));
    let (header, rest) = Part(bytes).split(1, HEADER as u64).ok_or_else(truncated)?;
    let read = |at| header.u32(at).unwrap_or_default();
    if header.array(0) != Some([0, 1]) {
        let found = header.array(0).map(|[major, minor]: [u8; 2]| format!("{major}.{minor}"));
        return Err(problem("version", "0.1", found.unwrap_or_default()));
    }
    let number = usize::from(header.u16(20).unwrap_or_default());
    if number > 2 {
        return Err(problem("compression", "level 0, 1 or 2", number));
    }
    let limit = |at, none| header.f32(at).filter(|limit| *limit != 0.0).unwrap_or(none);
    let (least, largest) = (limit(36, -DEFAULT_LIMIT), limit(40, DEFAULT_LIMIT));
    let level = Level { number, harmonics: [least, largest - least] };
    let (mut headers, mut rest) = rest.split(read(4).into(), SECTION_HEADER as u64).ok_or_else(truncated)?;
    let mut sections = Vec::new();
    while let Some((header, others)) = headers.split(1, SECTION_HEADER as u64) {
        headers = others;
        let section = Section::parse(header, number).ok_or_else(truncated)?;
        if section.sh_degree > 3 {
            return Err(problem("degree of the spherical harmonics", "0 to 3", section.sh_degree));
        }
        sections.push(section);
    }
    let count: u64 = sections.iter().map(|section| u64::from(section.count)).sum();
    if count != u64::from(read(16)) {
        return Err(problem("number of Gaussians", format!("the {count} of its sections"), read(16)));
    }
    if count > (bytes.len() / level.record_bytes(0)) as u64 {
        return Err(truncated());
    }
    let sh_degree = sections.iter().map(|section| section.sh_degree).max().unwrap_or_default();
    let mut gaussians = room_for(count, sh_degree)?;
    for section in &sections {
        rest = read_section(section, &level, rest, &mut gaussians, invisible)?.ok_or_else(truncated)?;
    }
    Ok(gaussians)
}

/// Appends the Gaussians of a section, and returns what follows; `None` if the file ends before.
fn read_section<'a>(
    section: &Section,
    level: &Level,
    rest: Part<'a>,
    to: &mut Gaussians,
    invisible: &mut Invisible,
) -> Result<Option<Part<'a>>, FileProblem> {
    if section.room < section.count {
        let expected = format!("room for {} Gaussians", section.count);
        return Err(problem("section", expected, format!("room for {}", section.room)));
    }
    let buckets = u64::from(section.full) + u64::from(section.others);
    if buckets > section.buckets.into() || (buckets > 0 && section.center_bytes < 12) {
        let expected = format!("{buckets} centres of three numbers");
        let found = format!("{} of {} bytes", section.buckets, section.center_bytes);
        return Err(problem("buckets", expected, found));
    }
    let Some((lengths, rest)) = rest.split(section.others.into(), 4) else { return Ok(None) };
    let Some((centers, rest)) = rest.split(section.buckets.into(), section.center_bytes.into()) else {
        return Ok(None);
    };
    let record_bytes = level.record_bytes(section.sh_degree) as u64;
    let Some((mut records, rest)) = rest.split(section.room.into(), record_bytes) else { return Ok(None) };
    let others = (0..section.others as usize).map(|index| lengths.u32(4 * index).unwrap_or_default());
    let lengths = std::iter::repeat_n(section.in_full, section.full as usize).chain(others);
    let mut buckets = lengths.enumerate();
    let (mut bucket, mut left) = (0, 0);
    for _ in 0..section.count {
        let Some((record, after)) = records.split(1, record_bytes) else { return Ok(None) };
        records = after;
        // Level 0 needs no buckets.
        while left == 0 && level.number > 0 {
            (bucket, left) = buckets.next().ok_or_else(|| {
                problem("buckets", format!("those of {} Gaussians", section.count), "fewer")
            })?;
        }
        left = left.saturating_sub(1);
        let center = usize::from(section.center_bytes) * bucket;
        let Some(values) =
            Values::read(record, level, section, Part(centers.0.get(center..).unwrap_or_default()))
        else {
            return Err(problem("buckets", "a centre for each", "fewer"));
        };
        values.push(to, invisible)?;
    }
    Ok(Some(rest))
}

/// What the file says of one Gaussian.
struct Values {
    position: Vec3,
    scale: Vec3,
    /// w, x, y, z.
    rotation: [f32; 4],
    color: [u8; 4],
    harmonics: Vec<[f32; 3]>,
}

impl Values {
    fn read(record: Part, level: &Level, section: &Section, center: Part) -> Option<Self> {
        let mut position = Vec3::ZERO;
        for axis in 0..3 {
            position[axis] = if level.number == 0 {
                record.f32(4 * axis)?
            } else {
                let steps = f32::from(record.u16(2 * axis)?) - section.steps as f32;
                steps * (section.half_side / section.steps as f32) + center.f32(4 * axis)?
            };
        }
        let width = if level.number == 0 { 4 } else { 2 };
        let number = |index| record.number(3 * width, index, level.number);
        Some(Self {
            position,
            scale: Vec3::new(number(0)?, number(1)?, number(2)?),
            rotation: [number(3)?, number(4)?, number(5)?, number(6)?],
            color: record.array(level.colors_at())?,
            harmonics: level.harmonics(record, section.sh_degree)?,
        })
    }

    fn push(self, to: &mut Gaussians, invisible: &mut Invisible) -> Result<(), FileProblem> {
        let finite = self.position.is_finite()
            && self.scale.is_finite()
            && self.rotation.iter().all(|part| part.is_finite())
            && self.harmonics.as_flattened().iter().all(|value| value.is_finite());
        if !finite {
            invisible.push(to);
            return Ok(());
        }
        let index = to.len();
        if !self.scale.cmpge(Vec3::ZERO).all() {
            return Err(problem(
                "scale",
                "lengths, not negative",
                format!("{} of Gaussian {index}", self.scale),
            ));
        }
        let [w, x, y, z] = self.rotation.map(f64::from);
        to.rotations.push(unit_rotation([x, y, z, w], index)?);
        to.positions.push(self.position);
        to.scales.push(self.scale);
        let [red, green, blue, opacity] = self.color.map(|byte| f64::from(byte) / 255.0);
        to.opacities.push(opacity as f32);
        to.sh.push([red, green, blue].map(|channel| ((channel - 0.5) / SH_0) as f32));
        to.sh.extend(&self.harmonics);
        // Sections may have lower degrees than the file.
        to.sh.extend(std::iter::repeat_n([0.0; 3], to.sh_len() - 1 - self.harmonics.len()));
        Ok(())
    }
}
