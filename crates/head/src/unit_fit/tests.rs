use srflow_core::random::Key;

use super::surface::{Nearest, Surface};
use super::warp::Warp;
use super::*;
use crate::dress::nearest_weights;
use crate::{Look, Offsets, Shape, ict};

/// Displacement of each vertex by each expression.
fn dense_offsets(model: &HeadModel) -> Vec<Vec<Vec3>> {
    let dense = |expression: &Shape| {
        let mut offsets = vec![Vec3::ZERO; model.template.len()];
        expression.offsets.iter().for_each(|(vertex, offset)| offsets[vertex as usize] += offset);
        offsets
    };
    model.expressions.iter().map(dense).collect()
}

/// A model whose expressions are mixed, so that none means anything: as many as before, in independent directions.
fn mixed(model: HeadModel) -> HeadModel {
    let mut stream = Key::new(8).stream("mixture");
    let own = dense_offsets(&model);
    let expressions = (0..own.len()).map(|number| {
        let mut offsets = vec![Vec3::ZERO; model.template.len()];
        for expression in &own {
            let weight = stream.normal() / (own.len() as f32).sqrt();
            offsets.iter_mut().zip(expression).for_each(|(sum, offset)| *sum += *offset * weight);
        }
        Shape::linear(format!("component{number:03}"), Offsets::Dense(offsets))
    });
    let expressions = expressions.collect();
    HeadModel { expressions, expressions_are_components: true, action_units: Vec::new(), ..model }
}

fn left(model: &HeadModel) -> Vec<(u8, Side, Left)> {
    let qualities = unit_qualities(model, Look::default()).into_iter();
    qualities.filter_map(|unit| Some((unit.number, unit.side, unit.left?))).collect()
}

fn mean(shares: impl Iterator<Item = f64> + Clone) -> f64 {
    shares.clone().sum::<f64>() / shares.count() as f64
}

#[test]
fn units_are_found_in_expressions_without_meaning() {
    let mut model = mixed(HeadModel::builtin(4));
    model.action_units = fitted_units(&model, &[26], Look::default());
    assert!(model.action_units.iter().all(|unit| unit.number != 26), "a known unit is not fitted");
    model.validate().unwrap();
    let left = left(&model);
    // All of the reference but the known one; the face has other proportions, and its lids move on an arc.
    assert_eq!(left.len(), HeadModel::builtin(4).action_units.len() - 1);
    let worst = left.iter().map(|(_, _, left)| left.skin).fold(0.0, f64::max);
    // That of AU 7, which hardly differs from what AU 6 does to the lower lid.
    assert!(worst < 0.6, "{worst} of a motion of the skin remains");
    for (of, mean) in [
        ("the skin", mean(left.iter().map(|(_, _, left)| left.skin))),
        ("the landmarks", mean(left.iter().map(|(_, _, left)| left.landmarks))),
    ] {
        assert!(mean < 0.25, "{mean} of the motion of {of} remains on average");
    }
}

#[test]
fn both_halves_of_a_unit_of_components_add_up() {
    let mut model = mixed(HeadModel::builtin(4));
    model.action_units = fitted_units(&model, &[], Look::default());
    let moved = |units: &[(u8, Side, f32)]| {
        let shaped = model.shaped(&[]);
        let mut vertices = Vec::new();
        model.vertices(&shaped, &model.pose_of_action_units(units).unwrap(), &mut vertices);
        vertices.iter().zip(&shaped.vertices).map(|(moved, rest)| *moved - *rest).collect::<Vec<Vec3>>()
    };
    let halves = [moved(&[(12, Side::Left, 1.0)]), moved(&[(12, Side::Right, 1.0)])];
    let both = moved(&[(12, Side::Both, 1.0)]);
    for (v, both) in both.iter().enumerate() {
        assert!(both.distance(halves[0][v] + halves[1][v]) < 1e-6, "vertex {v}");
    }
    // 43 and 45 are one by two names: an eye does not close twice.
    let once = moved(&[(45, Side::Left, 0.8)]);
    assert_eq!(moved(&[(43, Side::Left, 0.3), (45, Side::Left, 0.8)]), once);
}

#[test]
fn shapes_with_a_meaning_are_found_by_weights_from_0_to_1() {
    let own = HeadModel::builtin(4);
    let model = HeadModel { action_units: Vec::new(), ..own.clone() };
    let fitted = fitted_units(&model, &[26], Look::default());
    assert_eq!(fitted.len(), own.action_units.len() - 1);
    for unit in &fitted {
        assert!(unit.expressions.iter().all(|(_, weight)| (0.0..=1.0).contains(weight)), "{unit:?}");
        let largest = unit.expressions.iter().max_by(|a, b| a.1.total_cmp(&b.1)).unwrap();
        let name = &own.expressions[largest.0].name;
        let same = own.action_units.iter().find(|own| (own.number, own.side) == (unit.number, unit.side));
        assert_eq!(same.unwrap().expressions[0].0, largest.0, "AU{} is shown by {name}", unit.number);
        assert!(largest.1 > 0.5, "AU{} has {} of {name}", unit.number, largest.1);
    }
}

#[test]
fn a_head_carries_its_own_units_to_itself() {
    let model = HeadModel::sculpted_average(Look::default());
    for (number, side, left) in left(&model) {
        // Where two layers of skin are in one place, as at the closed lips, the other one may be found.
        assert!(left.landmarks < 1e-4 && left.skin < 0.05, "AU{number} {side:?}: {left:?}");
    }
}

#[test]
fn units_do_not_depend_on_the_number_of_threads() {
    let model = mixed(HeadModel::builtin(2));
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| fitted_units(&model, &[], Look::default()))
    };
    assert_eq!(with(1), with(3));
}

#[test]
fn heads_without_landmarks_or_expressions_have_no_units() {
    let model = HeadModel { action_units: Vec::new(), ..HeadModel::builtin(1) };
    let without = HeadModel { landmarks: Vec::new(), ..model.clone() };
    assert!(
        fitted_units(&without, &[], Look::default()).is_empty()
            && unit_qualities(&without, Look::default()).is_empty()
    );
    assert!(
        fitted_units(&HeadModel { expressions: Vec::new(), ..model.clone() }, &[], Look::default())
            .is_empty()
    );
    // A head without extent, and one that is far too large.
    for scale in [0.0, 1e9, f32::MAX] {
        let template = model.template.iter().map(|v| *v * scale).collect();
        assert!(
            fitted_units(&HeadModel { template, ..model.clone() }, &[], Look::default()).is_empty(),
            "{scale}"
        );
    }
}

#[test]
fn the_map_meets_its_points_and_is_affine_where_they_are() {
    let mut stream = Key::new(3).stream("warp");
    let mut point = |size: f64| DVec3::from_array(std::array::from_fn(|_| size * f64::from(stream.normal())));
    let from: Vec<DVec3> = (0..68).map(|_| point(0.05)).collect();
    let bent: Vec<DVec3> = from.iter().map(|p| *p * 1.2 + point(0.002)).collect();
    let warp = Warp::new(&from, &bent, 0.04).unwrap();
    for (from, to) in from.iter().zip(&bent) {
        let off = warp.at(*from).distance(*to);
        assert!(off < 5e-4, "{off} m off");
    }
    let moved: Vec<DVec3> = from.iter().map(|p| *p * 1.2 + DVec3::Y).collect();
    let warp = Warp::new(&from, &moved, 0.04).unwrap();
    let far = DVec3::new(0.3, -0.2, 0.5);
    assert!(warp.at(far).distance(far * 1.2 + DVec3::Y) < 1e-9);
    assert!(Warp::new(&[DVec3::X; 68], &moved, 0.04).is_none(), "points in one place");
    assert!(Warp::new(&from, &[DVec3::NAN; 68], 0.04).is_none());
}

#[test]
fn nearest_points_are_those_of_all_triangles() {
    let mut stream = Key::new(4).stream("surface");
    let mut point = |size: f32| Vec3::from_array(std::array::from_fn(|_| size * (stream.unit() - 0.5)));
    let vertices: Vec<Vec3> = (0..300)
        .flat_map(|_| {
            let corner = point(1.0);
            [corner, corner + point(0.1), corner + point(0.1)]
        })
        .collect();
    let triangles: Vec<[u32; 3]> = (0..300).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
    let surface = Surface::new(&vertices, &triangles, 0.05);
    let (mut found, mut none) = (0, 0);
    for _ in 0..400 {
        let (p, normal) = (point(1.2), point(1.0).normalize());
        let all = triangles.iter().map(|corners| {
            let [a, b, c] = corners.map(|v| vertices[v as usize]);
            let weights = nearest_weights([a, b, c], p);
            let distance = (a * weights.x + b * weights.y + c * weights.z).distance(p);
            let facing = (b - a).cross(c - a).normalize_or_zero().dot(normal) >= 0.35;
            (facing, Nearest { corners: *corners, weights, distance })
        });
        let within = all.filter(|(facing, nearest)| *facing && nearest.distance <= 0.15);
        let expected = within.map(|(_, nearest)| nearest).min_by(|a, b| a.distance.total_cmp(&b.distance));
        assert_eq!(surface.nearest(p, normal), expected);
        *(if expected.is_some() { &mut found } else { &mut none }) += 1;
    }
    assert!(found > 50 && none > 50, "{found} {none}");
}

/// ICT-FaceKit has action units of its own, which its expressions are the components of here. The numbers are in
/// docs/explanation/avatars.md.
#[test]
fn units_are_found_in_ict_facekit() {
    let folder = std::path::Path::new("../../../shared/data/ict-facekit/FaceXModel");
    if !folder.is_dir() {
        eprintln!("skipped: shared-data: no ICT-FaceKit at {}", folder.display());
        return;
    }
    let own = ict::load(folder).unwrap();
    let carried = Carried::onto(&own, Look::default()).unwrap();
    let shaped = own.shaped(&[]);
    let moved = |model: &HeadModel, unit: &CarriedUnit| -> Option<Vec<DVec3>> {
        let mut vertices = Vec::new();
        let pose = model.pose_of_action_units(&[(unit.number, unit.side, 1.0)]).ok()?;
        model.vertices(&shaped, &pose, &mut vertices);
        let moved = carried.samples.iter().map(|(v, _)| vertices[*v as usize] - shaped.vertices[*v as usize]);
        Some(moved.map(Vec3::as_dvec3).collect())
    };
    for components in [true, false] {
        let mut model = HeadModel { action_units: Vec::new(), ..own.clone() };
        model.expressions_are_components = components;
        model.action_units = fitted_units(&model, &[], Look::default());
        let (mut shares, mut against, mut cosines) = (Vec::new(), Vec::new(), Vec::new());
        for (unit, quality) in carried.units.iter().zip(unit_qualities(&model, Look::default())) {
            let Some(left) = quality.left else { continue };
            eprint!("AU{} {:?}: {:.2} {:.2}", unit.number, unit.side, left.landmarks, left.skin);
            shares.push(left);
            if let (Some(found), Some(truth)) = (moved(&model, unit), moved(&own, unit)) {
                let length = |moved: &[DVec3]| carried.length(moved.iter().copied());
                let off: Vec<DVec3> = found.iter().zip(&truth).map(|(a, b)| *a - *b).collect();
                let (a, b, off) = (length(&found), length(&truth), length(&off));
                against.push(off / b);
                cosines.push((a * a + b * b - off * off) / (2.0 * a * b));
                eprint!(", against its own {:.2}, cosine {:.2}", off / b, cosines[cosines.len() - 1]);
            }
            eprintln!();
        }
        let [landmarks, skin] = [|left: &Left| left.landmarks, |left: &Left| left.skin]
            .map(|of: fn(&Left) -> f64| mean(shares.iter().map(of)));
        let (off, cosine) = (mean(against.iter().copied()), mean(cosines.iter().copied()));
        eprintln!(
            "components {components}, {} units: landmarks {landmarks:.3}, skin {skin:.3}; {} against its own: {off:.3}, cosine {cosine:.3}\n",
            shares.len(),
            against.len()
        );
        assert!(
            shares.len() >= 20 && landmarks < 0.6 && skin < 0.8,
            "{} units, {landmarks}, {skin}",
            shares.len()
        );
        assert!(cosine > if components { 0.85 } else { 0.93 }, "{cosine}");
    }
}

#[test]
fn a_scan_takes_the_units_of_the_built_in_head() {
    let rigged = HeadModel::builtin(4);
    let mut scan = HeadModel { expressions: Vec::new(), action_units: Vec::new(), ..rigged.clone() };
    add_carried_units(&mut scan, Look::default());
    scan.validate().unwrap();
    assert_eq!(scan.action_units.len(), rigged.action_units.len());
    let left = left(&scan);
    let worst = left.iter().map(|(_, _, left)| left.skin).fold(0.0, f64::max);
    assert!(worst < 0.05, "{worst} of the carried motion remains on the scan");
    // The same as the person's own units, up to how smoothly heads map onto each other.
    let displacement = |model: &HeadModel, unit: u8| -> Vec<f32> {
        let moved = |units: &[(u8, Side, f32)]| {
            let mut vertices = Vec::new();
            model.vertices(&model.shaped(&[]), &model.pose_of_action_units(units).unwrap(), &mut vertices);
            vertices
        };
        let (rest, moved) = (moved(&[]), moved(&[(unit, Side::Both, 1.0)]));
        let landmarks = |vertices: &[Vec3]| model.landmarks_on(vertices).collect::<Vec<Vec3>>();
        let pairs = landmarks(&moved).into_iter().zip(landmarks(&rest));
        pairs.flat_map(|(moved, rest)| (moved - rest).to_array()).collect()
    };
    for unit in [1, 4, 9, 12, 15, 17, 20, 26, 43] {
        let (own, carried) = (displacement(&rigged, unit), displacement(&scan, unit));
        let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>();
        let cosine = dot(&own, &carried) / (dot(&own, &own) * dot(&carried, &carried)).sqrt();
        assert!(cosine > 0.9, "{unit}: {cosine}");
    }
    let mut faceless = HeadModel { landmarks: Vec::new(), expressions: Vec::new(), ..rigged };
    add_carried_units(&mut faceless, Look::default());
    assert!(faceless.expressions.is_empty());
}
