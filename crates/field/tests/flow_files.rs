//! Flow files: what is written is read again, and what is broken is refused in words.

use proptest::prelude::*;
use srflow_field::{FlowField, FlowFormat, read_flow, write_flow_as};

fn component() -> impl Strategy<Value = f32> {
    prop_oneof![
        -600.0_f32..600.0,
        prop::num::f32::NORMAL.prop_filter("in the range of .flo", |x| x.abs() <= 1e9),
        prop::num::f32::SUBNORMAL,
        Just(0.0),
        Just(-0.0),
    ]
}

fn flow() -> impl Strategy<Value = FlowField> {
    let pixel = prop_oneof![4 => [component(), component()], 1 => Just([f32::NAN; 2])];
    (1_usize..12, 1_usize..12).prop_flat_map(move |(width, height)| {
        prop::collection::vec(pixel.clone(), width * height)
            .prop_map(move |pixels| FlowField::from_pixels(width, height, pixels).unwrap())
    })
}

/// Bit patterns, so that -0.0 and 0.0 differ; every NaN is the same.
fn bits(flow: &FlowField) -> Vec<[u32; 2]> {
    flow.pixels().iter().map(|pixel| pixel.map(|x| if x.is_nan() { u32::MAX } else { x.to_bits() })).collect()
}

proptest! {
    #[test]
    fn float_formats_keep_every_bit(flow in flow()) {
        let folder = tempfile::tempdir().unwrap();
        for format in [FlowFormat::Flo, FlowFormat::Npy] {
            let path = folder.path().join(format!("flow.{format}"));
            write_flow_as(&path, &flow, format).unwrap();
            let again = read_flow(&path).unwrap();
            prop_assert_eq!(again.size(), flow.size());
            prop_assert_eq!(bits(&again), bits(&flow), "{}", format);
        }
    }
}
