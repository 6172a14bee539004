use super::*;

#[test]
fn builtin_heads_are_sound() {
    for seed in 0..4 {
        let head = HeadModel::builtin(seed);
        assert_eq!(head.validate(), Ok(()));
        assert_eq!(head.landmarks.len(), 68);
    }
}

#[test]
fn a_seed_always_gives_the_same_head_and_another_seed_another() {
    let (first, again, other) = (HeadModel::builtin(7), HeadModel::builtin(7), HeadModel::builtin(8));
    assert_eq!(first.template, again.template);
    assert_eq!(first.expressions, again.expressions);
    assert_eq!(first.triangles, other.triangles);
    assert_eq!(first.regions.len(), other.regions.len());
    let apart = first.template.iter().zip(&other.template).map(|(a, b)| a.distance(*b)).fold(0.0, f32::max);
    assert!(apart > 2e-3, "heads differ by {apart} m at most");
}
