//! Optical strain.

use srflow_core::{FlowField, Plane};
use srflow_mer::{StrainFormula, optical_strain, strain_colors};

fn linear(a: f32, b: f32, c: f32, d: f32) -> FlowField {
    FlowField::from_fn(9, 7, |x, y| [a * x as f32 + b * y as f32, c * x as f32 + d * y as f32])
}

fn inside(flow: &FlowField, formula: StrainFormula) -> f32 {
    optical_strain(flow, formula).get(4, 3)
}

#[test]
fn a_linear_flow_has_the_strain_of_its_gradient() {
    let strain = inside(&linear(0.3, 0.1, -0.2, 0.4), StrainFormula::Literature);
    let expected = (0.3_f32.powi(2) + 0.4_f32.powi(2) + 0.5 * (0.1_f32 - 0.2).powi(2)).sqrt();
    assert!((strain - expected).abs() < 1e-5, "{strain} {expected}");
}

#[test]
fn turning_and_moving_the_head_is_no_strain() {
    let turned = linear(0.0, -0.05, 0.05, 0.0);
    assert!(inside(&turned, StrainFormula::Literature) < 1e-6);
    let moved = FlowField::filled(5, 5, [3.0, -2.0]);
    assert!(optical_strain(&moved, StrainFormula::Literature).pixels().iter().all(|strain| *strain == 0.0));
}

#[test]
fn off_tanets_slip_misses_vertical_stretching_and_sees_turning() {
    let stretched = linear(0.0, 0.0, 0.0, 0.4);
    assert!((inside(&stretched, StrainFormula::Literature) - 0.4).abs() < 1e-6);
    assert_eq!(inside(&stretched, StrainFormula::OffTaNet), 0.0);
    assert!(inside(&linear(0.0, -0.05, 0.05, 0.0), StrainFormula::OffTaNet) > 0.3);
}

#[test]
fn tiny_flows_have_strain_too() {
    for (width, height) in [(1, 1), (1, 3), (2, 1), (2, 2)] {
        let strain = optical_strain(&FlowField::filled(width, height, [1.0, 2.0]), StrainFormula::Literature);
        assert!(strain.pixels().iter().all(|strain| *strain == 0.0));
    }
}

#[test]
fn colours_rise_from_black_to_white() {
    let plane = Plane::from_pixels(4, 1, vec![0.0, 1.0, 2.0, 3.0]).unwrap();
    let colors = strain_colors(&plane, None);
    assert_eq!(colors.pixels(), [[0, 0, 0], [255, 0, 0], [255, 255, 0], [255, 255, 255]]);
    assert_eq!(strain_colors(&Plane::new(2, 2), None).get(1, 1), [0; 3]);
}
