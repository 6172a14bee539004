//! Parameters of networks by name.

use std::collections::BTreeMap;

use burn::module::{Module, ModuleMapper, ModuleVisitor, Param};
use burn::tensor::{Tensor, TensorData};

/// Most names listed in an error.
const NAMES_SHOWN: usize = 10;

/// Name and shape of a parameter.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ParameterInfo {
    /// Name in the reference implementation, such as `fnet.layer1.0.conv1.weight`.
    pub name: String,
    pub shape: Vec<usize>,
}

/// Values of parameters, by name.
pub type Parameters = BTreeMap<String, TensorData>;

/// The differences between given parameters and those of a network.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the parameters do not fit the network:{}{}{}", listed("missing", .missing), listed("unknown", .unknown), listed("with another shape", .misshapen))]
pub struct ParametersError {
    /// Names that only the network has.
    pub missing: Vec<String>,
    /// Names that the network does not have.
    pub unknown: Vec<String>,
    /// Names with different shapes, each followed by the expected and the found shape.
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

/// Names and shapes of the parameters of a network, including running statistics, in the order of its definition.
pub fn parameter_infos(network: &impl Module) -> Vec<ParameterInfo> {
    let mut lister = Lister::default();
    network.visit(&mut lister);
    lister.found
}

/// The parameters of a network, including running statistics, as `f32`.
pub fn parameters(network: &impl Module) -> Parameters {
    let mut reader = Reader::default();
    network.visit(&mut reader);
    reader.found
}

/// `network` with the given parameters, which must be `f32`.
///
/// # Errors
/// When names or shapes are not exactly those of the network.
pub fn with_parameters<M: Module>(network: M, parameters: Parameters) -> Result<M, ParametersError> {
    compare(&parameter_infos(&network), &infos_of(&parameters))?;
    Ok(network.map(&mut Filler { path: Path::default(), parameters }))
}

/// Names and shapes of parameters.
pub fn infos_of(parameters: &Parameters) -> Vec<ParameterInfo> {
    let info = |(name, data): (&String, &TensorData)| ParameterInfo {
        name: name.clone(),
        shape: data.shape().to_vec(),
    };
    parameters.iter().map(info).collect()
}

/// Checks that `given` has exactly the names and shapes of `expected`, in any order.
///
/// # Errors
/// Lists the missing, unknown and misshapen parameters.
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

/// Path of a parameter in the network.
#[derive(Default)]
struct Path(Vec<String>);

impl Path {
    fn enter(&mut self, name: &str, container: &str) {
        if !is_variant(container) {
            // Fields named like Rust keywords are raw identifiers, such as `r#final`.
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

/// Burn adds the variant of an enum to the path; the reference has no such level.
fn is_variant(container: &str) -> bool {
    container.starts_with("Enum:")
}

#[derive(Default)]
struct Lister {
    path: Path,
    found: Vec<ParameterInfo>,
}

impl ModuleVisitor for Lister {
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
struct Reader {
    path: Path,
    found: Parameters,
}

impl ModuleVisitor for Reader {
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

struct Filler {
    path: Path,
    parameters: Parameters,
}

impl ModuleMapper for Filler {
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
