//! What files of any origin do not say about a head: where the face is, how long a unit is, where the head looks, what action units are.

use std::path::Path;

use glam::{Mat3, Vec3};

use crate::landmark_file::{on_triangle, read_rows};
use crate::regions::divide_skin;
use crate::unit_fit::{add_carried_units, fitted_units};
use crate::unit_table::{UNITS_NAME, read_units};
use crate::{HeadError, HeadModel, Look, Offsets, Region};

/// Landmarks beside the model: 68 rows of three vertices and their weights. Vertices count through the meshes in the order of the scene.
pub(crate) const LANDMARKS: &str = "landmarks_68.txt";

/// Files beside the model that are used if they exist.
pub(crate) const COMPANIONS: [&str; 2] = [LANDMARKS, UNITS_NAME];

/// Parts of names that tell what a mesh is; the first that occurs counts.
const PARTS: [(&str, Region); 22] = [
    ("lash", Region::Clear),
    ("brow", Region::Clear),
    ("hair", Region::Clear),
    ("beard", Region::Clear),
    ("glass", Region::Clear),
    ("cornea", Region::Clear),
    ("tear", Region::Clear),
    ("occlusion", Region::Clear),
    ("shirt", Region::Clear),
    ("outfit", Region::Clear),
    ("cloth", Region::Clear),
    ("hat", Region::Clear),
    ("cap", Region::Clear),
    ("teeth", Region::Teeth),
    ("tooth", Region::Teeth),
    ("tongue", Region::MouthInside),
    ("gum", Region::MouthInside),
    ("mouth", Region::MouthInside),
    ("eyelid", Region::Skin),
    ("eye", Region::Eyeball),
    ("iris", Region::Eyeball),
    ("sclera", Region::Eyeball),
];

/// Distance between the outer corners of an adult's eyes, metres, and the largest factor by which it differs among heads.
const EYES: f32 = 0.089;
const EYES_DIFFER: f32 = 1.55;

/// Extent of a head, a bust or a whole person, metres.
const EXTENT: [f32; 2] = [0.12, 2.6];

/// Extent of a mesh without landmarks in no known unit, metres: that of a head with its neck.
const UNKNOWN_EXTENT: f32 = 0.35;

/// Units of length, metres. A mesh that could be in two of them is in the first.
const UNITS: [(f32, &str); 4] =
    [(1.0, "metres"), (1e-3, "millimetres"), (1e-2, "centimetres"), (0.0254, "inches")];

/// The model of the file `path` with the landmarks beside it, in metres, looking along +z, with regions and action units.
///
/// # Errors
/// Names the file that is malformed.
pub(crate) fn found_head(mut model: HeadModel, path: &Path, look: Look) -> Result<HeadModel, HeadError> {
    let landmarks = path.with_file_name(LANDMARKS);
    if landmarks.exists() {
        let rows = read_rows(&landmarks, model.template.len())?;
        model.landmarks =
            rows.iter().map(|row| on_triangle(row, &model.template, &model.triangles)).collect();
    }
    model.validate()?;
    let name = path.display();
    if let Some((scale, unit)) = unit(&model) {
        log::warn!("{name} is {:.3} units large, which cannot be metres: taken as {unit}", extent(&model));
        transform(&mut model, Mat3::from_diagonal(Vec3::splat(scale)));
    }
    // A rig keeps the axes of its file, which clips of motion refer to.
    if model.joints.len() == 1
        && let Some(turn) = turn(&model)
    {
        let [x, y, z] = turn.row(2).to_array();
        log::warn!("{name}: the face looks along ({x}, {y}, {z}): the head is turned to look along +z");
        transform(&mut model, turn);
    }
    model.validate()?;
    divide_skin(&mut model, &[]);
    if let Some(units) = read_units(&path.with_file_name(UNITS_NAME), &model)? {
        model.action_units = units;
    } else if model.expressions.is_empty() {
        add_carried_units(&mut model, look);
    } else if model.action_units.is_empty() {
        model.action_units = fitted_units(&model, &[], look);
    }
    Ok(model)
}

/// Region of a part of a mesh by its names.
pub(crate) fn region_of_name(names: &str) -> Region {
    let names = names.to_lowercase();
    PARTS.iter().find(|(part, _)| names.contains(part)).map_or(Region::Skin, |(_, region)| *region)
}

/// Largest side of the box around a model.
fn extent(model: &HeadModel) -> f32 {
    let start = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    let (low, high) =
        model.template.iter().fold(start, |(low, high), vertex| (low.min(*vertex), high.max(*vertex)));
    (high - low).max_element().max(0.0)
}

/// Metres from the units of a model and their name; `None` where they are metres.
fn unit(model: &HeadModel) -> Option<(f32, String)> {
    let extent = extent(model);
    let landmarks: Vec<Vec3> = model.landmarks_on(&model.template).collect();
    let eyes = landmarks.get(36).zip(landmarks.get(45)).map(|(right, left)| right.distance(*left));
    let fits = |metres: f32| match eyes {
        Some(eyes) => (EYES / EYES_DIFFER..=EYES * EYES_DIFFER).contains(&(eyes * metres)),
        None => (EXTENT[0]..=EXTENT[1]).contains(&(extent * metres)),
    };
    let known = UNITS.into_iter().find(|(metres, _)| fits(*metres));
    let (scale, name) = known.map_or_else(
        || {
            let scale = eyes.map_or(UNKNOWN_EXTENT / extent, |eyes| EYES / eyes);
            (scale, format!("{} mm", 1000.0 * scale))
        },
        |(metres, name)| (metres, name.to_owned()),
    );
    (scale != 1.0 && scale.is_finite()).then_some((scale, name))
}

/// The turn by right angles after which the face looks along +z with +y up; `None` where it does, or without landmarks.
fn turn(model: &HeadModel) -> Option<Mat3> {
    let landmarks: Vec<Vec3> = model.landmarks_on(&model.template).take(68).collect();
    if landmarks.len() < 68 {
        return None;
    }
    let left = landmarks[45] - landmarks[36];
    let up = landmarks[27] - landmarks[8];
    let forward = left.cross(up);
    let axes = [Vec3::X, Vec3::NEG_X, Vec3::Y, Vec3::NEG_Y, Vec3::Z, Vec3::NEG_Z];
    let along =
        |direction: Vec3| axes.into_iter().max_by(|a, b| a.dot(direction).total_cmp(&b.dot(direction)));
    let (forward, up) = (along(forward)?, along(up)?);
    let turn = Mat3::from_cols(up.cross(forward), up, forward).transpose();
    (turn != Mat3::IDENTITY && turn.determinant() > 0.5).then_some(turn)
}

/// Transforms a model without identities and correctives at rest.
fn transform(model: &mut HeadModel, here_from_there: Mat3) {
    model.template.iter_mut().for_each(|vertex| *vertex = here_from_there * *vertex);
    model.joints.iter_mut().for_each(|joint| joint.position = here_from_there * joint.position);
    for shape in &mut model.expressions {
        let offsets =
            shape.offsets.iter().map(|(vertex, offset)| (vertex, here_from_there * offset)).collect();
        shape.offsets = Offsets::Sparse(offsets);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_give_regions() {
        for (name, region) in [
            ("Wolf3D_Head Wolf3D_Skin", Region::Skin),
            ("Wolf3D_Teeth", Region::Teeth),
            ("EyeLeft", Region::Eyeball),
            ("Eyelashes", Region::Clear),
        ] {
            assert_eq!(region_of_name(name), region, "{name}");
        }
    }

    #[test]
    fn heads_of_any_unit_and_direction_are_metres_that_look_along_z() {
        let built_in = HeadModel::builtin(7);
        let same = |model: &HeadModel| {
            let apart = |(a, b): (&Vec3, &Vec3)| a.distance(*b);
            model.template.iter().zip(&built_in.template).map(apart).fold(0.0, f32::max)
        };
        let turns = [
            Mat3::IDENTITY,
            Mat3::from_cols(Vec3::NEG_X, Vec3::Y, Vec3::NEG_Z),
            Mat3::from_cols(Vec3::X, Vec3::Z, Vec3::NEG_Y),
            Mat3::from_cols(Vec3::Z, Vec3::Y, Vec3::NEG_X),
        ];
        for (metres, _) in UNITS {
            for there_from_here in turns {
                let mut model = built_in.clone();
                transform(&mut model, there_from_here * (1.0 / metres));
                let scale = unit(&model);
                assert_eq!(scale.as_ref().map_or(1.0, |(scale, _)| *scale), metres);
                transform(&mut model, Mat3::from_diagonal(Vec3::splat(metres)));
                let turn = turn(&model);
                assert_eq!(turn.is_none(), there_from_here == Mat3::IDENTITY);
                transform(&mut model, turn.unwrap_or(Mat3::IDENTITY));
                assert!(same(&model) < 1e-6, "{metres} {there_from_here:?}: {}", same(&model));
            }
        }
        // Of no unit: by the eyes.
        let mut model = built_in.clone();
        transform(&mut model, Mat3::from_diagonal(Vec3::splat(5.0)));
        let (scale, _) = unit(&model).unwrap();
        assert!((scale * 5.0 - 1.0).abs() < 0.3, "{scale}");
        // Without landmarks: by the size.
        model.landmarks.clear();
        assert!(unit(&built_in).is_none() && turn(&model).is_none());
        let (scale, _) = unit(&HeadModel { template: vec![Vec3::ZERO, Vec3::Y * 260.0], ..model }).unwrap();
        assert_eq!(scale, 1e-3);
    }
}
