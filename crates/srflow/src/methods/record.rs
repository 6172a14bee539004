//! The description of flow methods that results store.

use srflow_classical::TvL1Parameters;
use srflow_eval::MethodRecord;
use srflow_mer::file_digest;
use srflow_nets::included_sha256;
use srflow_ops::Precision;

use super::labels::labels;
use super::{Method, MethodParameters, MethodSpec, distinct};
use crate::Watch;
use crate::networks::Weights;

/// One record per method, in the order of [`super::estimators`].
///
/// # Errors
/// When weights cannot be found or read.
pub fn records(
    specs: &[MethodSpec],
    parameters: &MethodParameters,
    watch: &Watch,
) -> anyhow::Result<Vec<MethodRecord>> {
    let specs = distinct(specs);
    let labels = labels(&specs);
    specs.into_iter().zip(labels).map(|(spec, name)| record(spec, name, parameters, watch)).collect()
}

fn record(
    spec: &MethodSpec,
    name: String,
    parameters: &MethodParameters,
    watch: &Watch,
) -> anyhow::Result<MethodRecord> {
    let MethodParameters { network, large_frames, farneback, tvl1, .. } = parameters;
    let network = network.of(spec.iterations, &spec.settings);
    let (mut own, weights) = match spec.method {
        Method::Farneback => (format!("{:?}", farneback.parameters()), None),
        Method::TvL1 => (format!("{:?}", tvl1.or(TvL1Parameters::default())), None),
        Method::Network(architecture) => {
            let most = network.iterations(architecture);
            let iterations = match network.still_px(architecture) {
                Some(px) => format!("at most {most} iterations, until the flow moves less than {px} px,"),
                None => format!("{most} iterations"),
            };
            let mut own = format!("{iterations} on {}", network.device);
            let precision = network.precision()?;
            if precision != Precision::F32 {
                own += &format!(" at {}", precision.name());
            }
            let tolerance = network.attention_tolerance(architecture);
            if tolerance > 0.0 {
                own += &format!(", attention within {tolerance}");
            }
            for (name, value) in network.settings(architecture)? {
                own += &format!(", {name}={value}");
            }
            (own, Some((architecture, network.weights_of(architecture, spec.weights.as_deref(), watch)?)))
        }
        Method::Files => (format!("files in {}", spec.weights.as_deref().unwrap_or_default()), None),
    };
    let network_of = |architecture| (network.iterations(architecture), network.device.clone());
    let (iterations, device) = match spec.method {
        Method::Network(architecture) => Some(network_of(architecture)).unzip(),
        _ => (None, None),
    };
    let still_px = spec.method.network().and_then(|architecture| network.still_px(architecture));
    if large_frames.given() {
        own += &format!(", {large_frames:?}");
    }
    if let Some(refinement) = parameters.refinement() {
        own += &format!(", refined by {refinement:?}");
    }
    let (weights, sha256) = match weights {
        None => (None, None),
        Some((_, Weights::File(path))) => (Some(path.display().to_string()), Some(file_digest(&path)?)),
        Some((network, Weights::Included)) => (Some("included".to_owned()), included_sha256(network)),
    };
    Ok(MethodRecord {
        name,
        method: spec.method.name(),
        parameters: own,
        sha256,
        weights,
        iterations,
        still_px,
        device,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_identity_covers_everything_the_flow_depends_on() {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str, bytes: &str| {
            std::fs::write(folder.path().join(name), bytes).unwrap();
            folder.path().join(name).display().to_string()
        };
        let (a, same, other) = (file("a.pth", "a"), file("same.pth", "a"), file("other.pth", "b"));
        let specs =
            [format!("raft={a}"), format!("x:raft={same}"), format!("raft={other}"), format!("gma={a}")];
        let specs: Vec<MethodSpec> =
            specs.iter().map(String::as_str).chain(["tvl1"]).map(|text| text.parse().unwrap()).collect();
        let of = |parameters: &MethodParameters| -> Vec<String> {
            records(&specs, parameters, &Watch::SILENT).unwrap().iter().map(MethodRecord::identity).collect()
        };
        let plain = of(&MethodParameters::default());
        assert_eq!(plain[0], plain[1], "neither name nor place of the weights");
        assert!(plain[0] != plain[2] && plain[0] != plain[3]);
        let mut specs_of_auto = specs.clone();
        let mut identities = vec![plain[0].clone()];
        for iterations in ["12", "auto", "auto:0.02"] {
            specs_of_auto[0].iterations = Some(iterations.parse().unwrap());
            let record =
                records(&specs_of_auto, &MethodParameters::default(), &Watch::SILENT).unwrap().remove(0);
            assert_eq!(record.still_px.is_some(), iterations.starts_with("auto"));
            assert!(!identities.contains(&record.identity()), "{iterations}");
            identities.push(record.identity());
        }
        let mut parameters = MethodParameters::default();
        parameters.tvl1.tau = Some(0.125);
        let changed = of(&parameters);
        assert_eq!(plain[..4], changed[..4], "parameters of other methods");
        assert_ne!(plain[4], changed[4]);
    }
}
