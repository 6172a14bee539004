//! The description of flow methods that results store.

use std::fmt;

use serde::Serialize;
use serde_json::{Value, json};
use srflow_classical::TvL1Parameters;
use srflow_eval::MethodRecord;
use srflow_mer::file_digest;
use srflow_nets::{Architecture, included_sha256};
use srflow_ops::Precision;

use super::labels::labels;
use super::{Method, MethodParameters, MethodSpec, distinct};
use crate::Watch;
use crate::networks::{NetworkArgs, Weights};

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
    let (mut text, settings, weights) = match spec.method {
        Method::Farneback => classical(&farneback.parameters())?,
        Method::TvL1 => classical(&tvl1.or(TvL1Parameters::default()))?,
        Method::Network(architecture) => {
            let (text, settings) = of_network(&network, architecture)?;
            let weights = network.weights_of(architecture, spec.weights.as_deref(), watch)?;
            (text, settings, Some((architecture, weights)))
        }
        Method::Files => {
            let folder = spec.weights.as_deref().unwrap_or_default();
            (format!("files in {folder}"), json!({ "folder": folder }), None)
        }
    };
    let refinement = parameters.refinement();
    if large_frames.given() {
        text += &format!(", {large_frames:?}");
    }
    if let Some(refinement) = &refinement {
        text += &format!(", refined by {refinement:?}");
    }
    let (weights, sha256) = match weights {
        None => (None, None),
        Some((_, Weights::File(path))) => (Some(path.display().to_string()), Some(file_digest(&path)?)),
        Some((network, Weights::Included)) => (Some("included".to_owned()), included_sha256(network)),
    };
    let start = spec.method.network().and_then(|architecture| parameters.start_of(architecture));
    let start = start.map(|(start, inner)| record(start, start.to_string(), &inner, watch)).transpose()?;
    if let Some(start) = &start {
        text += &format!(", started from {} ({})", start.name, start.parameters);
    }
    let method = spec.method.name();
    let large_frames = large_frames.given().then_some(large_frames);
    let architecture = spec.method.network();
    let mut identity = json!({
        "version": 1,
        "method": method,
        "settings": settings,
        "weights": sha256,
        "large_frames": large_frames,
        "refinement": refinement,
    });
    // No key without a start: results that were kept before there were starts stay valid.
    if let Some(start) = start {
        identity["start"] = start.identity;
    }
    Ok(MethodRecord {
        name,
        method,
        parameters: text,
        identity,
        sha256,
        weights,
        iterations: architecture.map(|architecture| network.iterations(architecture)),
        still_px: architecture.and_then(|architecture| network.still_px(architecture)),
        device: architecture.map(|_| network.device.clone()),
    })
}

type Described = (String, Value, Option<(Architecture, Weights)>);

fn classical(parameters: &(impl fmt::Debug + Serialize)) -> anyhow::Result<Described> {
    Ok((format!("{parameters:?}"), serde_json::to_value(parameters)?, None))
}

/// The settings that the flow of a network depends on, besides its weights, as text and as JSON.
fn of_network(network: &NetworkArgs, architecture: Architecture) -> anyhow::Result<(String, Value)> {
    let (iterations, still_px) = (network.iterations(architecture), network.still_px(architecture));
    let mut text = match still_px {
        Some(px) => format!("at most {iterations} iterations, until the flow moves less than {px} px,"),
        None => format!("{iterations} iterations"),
    };
    text += &format!(" on {}", network.device);
    let precision = network.precision()?;
    if precision != Precision::F32 {
        text += &format!(" at {}", precision.name());
    }
    let own = network.settings(architecture)?;
    for (name, value) in &own {
        text += &format!(", {name}={value}");
    }
    let settings = json!({
        "iterations": iterations,
        "still_px": still_px,
        "device": network.device,
        "precision": precision.name(),
        "own": own,
    });
    Ok((text, settings))
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
        let of = |parameters: &MethodParameters| -> Vec<Value> {
            let records = records(&specs, parameters, &Watch::SILENT).unwrap();
            records.into_iter().map(|record| record.identity).collect()
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
            assert!(!identities.contains(&record.identity), "{iterations}");
            identities.push(record.identity);
        }
        let mut parameters = MethodParameters::default();
        parameters.tvl1.tau = Some(0.125);
        let changed = of(&parameters);
        assert_eq!(plain[..4], changed[..4], "parameters of other methods");
        assert_ne!(plain[4], changed[4]);
    }
}
