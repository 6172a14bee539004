//! The flow is bit-identical on every instruction set. In a file of its own, since the choice is process-wide.

use srflow_classical::{Farneback, FarnebackParameters, TvL1, TvL1Parameters};
use srflow_core::random::Key;
use srflow_core::{FlowEstimator, Image};
use srflow_simd::Isa;

/// Smooth blobs that move by three pixels, in a size that is no multiple of the vector length.
fn frame(shift: usize) -> Image {
    let mut stream = Key::new(5).stream("texture");
    let coarse: Vec<f32> = (0..24 * 24).map(|_| stream.uniform(20.0, 235.0)).collect();
    Image::from_fn(101, 67, |x, y| {
        let (x, y) = ((x + shift) as f32 / 6.0, (y + shift) as f32 / 6.0);
        let at = |dx: usize, dy: usize| coarse[(y as usize + dy) * 24 + x as usize + dx];
        let (u, v) = (x.fract(), y.fract());
        let (upper, lower) = (at(0, 0) * (1.0 - u) + at(1, 0) * u, at(0, 1) * (1.0 - u) + at(1, 1) * u);
        [(upper * (1.0 - v) + lower * v) as u8; 3]
    })
}

#[test]
fn every_instruction_set_gives_the_same_bits() {
    let methods: [Box<dyn FlowEstimator>; 2] = [
        Box::new(Farneback::new(FarnebackParameters::default()).expect("valid")),
        Box::new(TvL1::new(TvL1Parameters::default()).expect("valid")),
    ];
    for method in methods {
        let flows: Vec<_> = Isa::to_test()
            .map(|isa| {
                isa.limit_process();
                (isa, method.estimate(&frame(0), &frame(3)).expect("flow"))
            })
            .collect();
        assert!(flows[0].1.pixels().iter().any(|[u, _]| u.abs() > 1.0), "{}: nothing moves", method.name());
        for (isa, flow) in &flows {
            assert!(*flow == flows[0].1, "{}: {isa:?} differs", method.name());
        }
    }
}
