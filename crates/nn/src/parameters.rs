//! A network's parameters by name.

use std::collections::BTreeMap;

use burn::module::{Module, ModuleMapper, ModuleVisitor, Param};
use burn::tensor::{Tensor, TensorData};

/// Names listed in an error, of however many there are.
const NAMES_SHOWN: usize = 10;

/// Name and shape of a parameter.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ParameterInfo {
    /// As the reference implementation calls it, such as `fnet.layer1.0.conv1.weight`.
    pub name: String,
    pub shape: Vec<usize>,
}

/// Values for parameters, by name.
pub type Parameters = BTreeMap<String, TensorData>;

/// Why parameters do not fit a network.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the parameters do not fit the network:{}{}{}", listed("missing", .missing), listed("unknown", .unknown), listed("of another shape", .misshapen))]
pub struct ParametersError {
    /// Parameters of the network that were not given.
    pub missing: Vec<String>,
    /// Given names that the network does not have.
    pub unknown: Vec<String>,
    /// Parameters given in another shape: the name, the shape expected and the shape found.
    pub misshapen: Vec<String>,
}

fn listed(what: &str, names: &[String]) -> String {
    if names.is_empty() {
        return String::new();
    }
    let shown = names[..names.len().min(NAMES_SHOWN)].join(", ");
    let rest = names.len().saturating_sub(NAMES_SHOWN);
    let rest = if rest > 0 { format!(" and {rest} more") } else { String::new() };
    format!("\n  {} {what}: {shown}{rest}", names.len())
}

/// Every parameter of a network, in the order of its definition.
pub fn parameter_infos(network: &impl Module) -> Vec<ParameterInfo> {
    let mut listing = Listing::default();
    network.visit(&mut listing);
    listing.found
}

/// Every parameter of a network with its values, as `f32`.
pub fn parameters(network: &impl Module) -> Parameters {
    let mut reading = Reading::default();
    network.visit(&mut reading);
    reading.found
}

/// `network` with the given parameters. `parameters` must hold each of the network's and no other, as `f32`.
pub fn with_parameters<M: Module>(network: M, parameters: Parameters) -> Result<M, ParametersError> {
    let given: Vec<ParameterInfo> = parameters
        .iter()
        .map(|(name, data)| ParameterInfo { name: name.clone(), shape: data.shape().to_vec() })
        .collect();
    compare(&parameter_infos(&network), &given)?;
    Ok(network.map(&mut Filling { path: Path::default(), parameters }))
}

/// Whether `given` are the parameters of a network that expects `expected`, each and no other.
///
/// # Errors
/// What is missing, unknown or of another shape.
pub fn compare(expected: &[ParameterInfo], given: &[ParameterInfo]) -> Result<(), ParametersError> {
    let mut given: BTreeMap<&str, &[usize]> =
        given.iter().map(|info| (info.name.as_str(), info.shape.as_slice())).collect();
    let (mut missing, mut misshapen) = (Vec::new(), Vec::new());
    for ParameterInfo { name, shape } in expected {
        match given.remove(name.as_str()) {
            None => missing.push(name.clone()),
            Some(found) if found != shape => {
                misshapen.push(format!("{name} (expected {shape:?}, found {found:?})"))
            }
            Some(_) => {}
        }
    }
    let unknown: Vec<String> = given.into_keys().map(|name| name.escape_debug().to_string()).collect();
    if missing.is_empty() && misshapen.is_empty() && unknown.is_empty() {
        Ok(())
    } else {
        Err(ParametersError { missing, unknown, misshapen })
    }
}

/// Where in the network a parameter is.
#[derive(Default)]
struct Path(Vec<String>);

impl Path {
    fn enter(&mut self, name: &str, container: &str) {
        if !is_variant(container) {
            // A field may have a name that is a word of Rust, such as `r#final`.
            self.0.push(name.trim_start_matches("r#").to_owned());
        }
    }

    fn exit(&mut self, container: &str) {
        if !is_variant(container) {
            self.0.pop();
        }
    }

    fn name(&self) -> String {
        self.0.join(".")
    }
}

/// Burn puts an enum's variant into the path; the reference has no such level.
fn is_variant(container: &str) -> bool {
    container.starts_with("Enum:")
}

#[derive(Default)]
struct Listing {
    path: Path,
    found: Vec<ParameterInfo>,
}

impl ModuleVisitor for Listing {
    fn enter_module(&mut self, name: &str, container: &str) {
        self.path.enter(name, container);
    }

    fn exit_module(&mut self, _: &str, container: &str) {
        self.path.exit(container);
    }

    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        self.found.push(ParameterInfo { name: self.path.name(), shape: param.lazy_shape().to_vec() });
    }
}

#[derive(Default)]
struct Reading {
    path: Path,
    found: Parameters,
}

impl ModuleVisitor for Reading {
    fn enter_module(&mut self, name: &str, container: &str) {
        self.path.enter(name, container);
    }

    fn exit_module(&mut self, _: &str, container: &str) {
        self.path.exit(container);
    }

    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        self.found.insert(self.path.name(), param.val().into_data().convert::<f32>());
    }
}

struct Filling {
    path: Path,
    parameters: Parameters,
}

impl ModuleMapper for Filling {
    fn enter_module(&mut self, name: &str, container: &str) {
        self.path.enter(name, container);
    }

    fn exit_module(&mut self, _: &str, container: &str) {
        self.path.exit(container);
    }

    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let Some(data) = self.parameters.remove(&self.path.name()) else { return param };
        let device = param.lazy_device();
        let tensor = Tensor::from_data(data, &device);
        let id = param.id;
        param.transform_for_load(tensor, id)
    }
}
