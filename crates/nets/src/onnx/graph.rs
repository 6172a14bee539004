//! A graph of ONNX's operators in the making. It knows the shapes of its tensors: a length is a number, or, where the size of the frames
//! is open, a tensor that the graph computes.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::rc::Rc;

use srflow_nn::Parameters;

use super::proto::{
    AttributeProto, AttributeType, DataType, DimensionProto, DimensionValue, GraphProto, NodeProto,
    TensorProto, TensorShapeProto, TensorTypeProto, TypeProto, ValueInfoProto,
};

/// Length of an axis.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub(crate) enum Length {
    Known(i64),
    /// So many times an int64 tensor `[1]`, by its name.
    Computed(i64, Rc<str>),
}

/// Axis of an input.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Axis {
    Known(i64),
    /// Any length, the same wherever this name is used.
    Named(&'static str),
}

/// A tensor of `f32`.
#[derive(Debug, Clone)]
pub(crate) struct Value {
    name: Rc<str>,
    shape: Vec<Length>,
}

/// Value of an attribute.
#[derive(Debug, Clone)]
pub(crate) enum Attribute {
    Int(i64),
    Float(f32),
    Ints(Vec<i64>),
    Text(&'static str),
}

/// Pixels beside a map.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Sides {
    pub(crate) top: Length,
    pub(crate) left: Length,
    pub(crate) bottom: Length,
    pub(crate) right: Length,
}

/// Operators, constants and parameters. Methods panic where shapes do not fit, as Burn's operations do: the shapes of a network of the
/// table do not depend on a user.
#[derive(Debug)]
pub(crate) struct Graph {
    parameters: Parameters,
    /// Precedes the names of nodes.
    scope: String,
    nodes: Vec<NodeProto>,
    initializers: Vec<TensorProto>,
    inputs: Vec<ValueInfoProto>,
    outputs: Vec<ValueInfoProto>,
    /// Lengths of named axes.
    named: BTreeMap<&'static str, Length>,
    /// Parameters among the initializers.
    used: BTreeMap<String, Value>,
    /// Constants, lengths and lists of them, each of which is made once.
    constants: HashMap<(DataType, Vec<i64>, Vec<u8>), Rc<str>>,
    lengths: HashMap<(&'static str, Length, Length), Rc<str>>,
    lists: HashMap<Vec<Length>, Rc<str>>,
}

impl From<i64> for Length {
    fn from(length: i64) -> Self {
        Self::Known(length)
    }
}

impl Length {
    /// Panics when the graph computes it.
    fn known(&self) -> i64 {
        match self {
            Self::Known(length) => *length,
            Self::Computed(_, name) => panic!("the length {name} is known only when the graph runs"),
        }
    }
}

impl Sides {
    /// The same number of pixels on every side.
    pub(crate) fn all(pixels: i64) -> Self {
        let side = || Length::Known(pixels);
        Self { top: side(), left: side(), bottom: side(), right: side() }
    }
}

impl Value {
    /// Stands for an optional input that is left out.
    pub(crate) fn omitted() -> Self {
        Self { name: "".into(), shape: Vec::new() }
    }

    pub(crate) fn length(&self, axis: usize) -> Length {
        self.shape[axis].clone()
    }

    /// The length of an axis, which the graph must not compute.
    pub(crate) fn known(&self, axis: usize) -> i64 {
        self.shape[axis].known()
    }

    /// Height and width of a map.
    pub(crate) fn size(&self) -> [Length; 2] {
        [self.length(2), self.length(3)]
    }

    /// The shape with another number of channels.
    pub(crate) fn with_channels(&self, channels: i64) -> Vec<Length> {
        let mut shape = self.shape.clone();
        shape[1] = Length::Known(channels);
        shape
    }

    pub(crate) fn shape(&self) -> Vec<Length> {
        self.shape.clone()
    }
}

impl Graph {
    /// An empty graph of a network with these parameters.
    pub(crate) fn new(parameters: Parameters) -> Self {
        Self {
            parameters,
            scope: String::new(),
            nodes: Vec::new(),
            initializers: Vec::new(),
            inputs: Vec::new(),
            outputs: Vec::new(),
            named: BTreeMap::new(),
            used: BTreeMap::new(),
            constants: HashMap::new(),
            lengths: HashMap::new(),
            lists: HashMap::new(),
        }
    }

    /// The graph, without nodes and constants that no output depends on.
    pub(crate) fn finish(mut self, name: &str) -> GraphProto {
        let mut needed: BTreeSet<String> =
            self.outputs.iter().filter_map(|output| output.name.clone()).collect();
        // A node comes after those that it depends on.
        let mut nodes: Vec<NodeProto> = Vec::with_capacity(self.nodes.len());
        while let Some(node) = self.nodes.pop() {
            if node.output.iter().any(|output| needed.contains(output)) {
                needed.extend(node.input.iter().cloned());
                nodes.push(node);
            }
        }
        nodes.reverse();
        self.initializers.retain(|tensor| tensor.name.as_ref().is_some_and(|name| needed.contains(name)));
        GraphProto {
            node: nodes,
            name: Some(name.to_owned()),
            initializer: self.initializers,
            input: self.inputs,
            output: self.outputs,
        }
    }

    /// Begins a part of the graph. The name is in those of its nodes.
    pub(crate) fn begin(&mut self, scope: impl Into<String>) {
        self.scope = scope.into();
    }

    pub(crate) fn input(&mut self, name: &'static str, description: &str, shape: &[Axis]) -> Value {
        let dimensions = shape.iter().map(|axis| match axis {
            Axis::Known(length) => DimensionValue::Length(*length),
            Axis::Named(name) => DimensionValue::Name((*name).to_owned()),
        });
        self.inputs.push(described(name, description, dimensions.map(Some)));
        let mut lengths = Vec::with_capacity(shape.len());
        for (place, axis) in (0..).zip(shape) {
            lengths.push(match axis {
                Axis::Known(length) => Length::Known(*length),
                Axis::Named(symbol) => self.named_length(symbol, name, place),
            });
        }
        Value { name: name.into(), shape: lengths }
    }

    fn named_length(&mut self, symbol: &'static str, input: &str, axis: i64) -> Length {
        if let Some(length) = self.named.get(symbol) {
            return length.clone();
        }
        let ends = [("start", Attribute::Int(axis)), ("end", Attribute::Int(axis + 1))];
        let length = Length::Computed(1, self.node("Shape", symbol, &[input], &ends));
        self.named.insert(symbol, length.clone());
        length
    }

    pub(crate) fn output(&mut self, name: &'static str, description: &str, value: &Value) {
        let attributes: [(&str, Attribute); 0] = [];
        self.push("Identity", name, &[&value.name], name.to_owned(), &attributes);
        let dimensions = value.shape.iter().map(|length| match length {
            Length::Known(length) => Some(DimensionValue::Length(*length)),
            Length::Computed(..) => {
                let symbol = self.named.iter().find(|(_, named)| *named == length);
                symbol.map(|(symbol, _)| DimensionValue::Name((*symbol).to_owned()))
            }
        });
        self.outputs.push(described(name, description, dimensions));
    }

    /// Whether the network has a parameter of this name.
    pub(crate) fn has(&self, name: &str) -> bool {
        self.parameters.contains_key(name)
    }

    /// The parameter of this name. Panics when the network has none.
    pub(crate) fn parameter(&mut self, name: &str) -> Value {
        if let Some(value) = self.used.get(name) {
            return value.clone();
        }
        let data = self.parameters.get(name).unwrap_or_else(|| panic!("the network has no parameter {name}"));
        let dims: Vec<i64> = data.shape().iter().map(|length| *length as i64).collect();
        let bytes = data.iter::<f32>().flat_map(f32::to_le_bytes).collect();
        self.initializers.push(tensor(name, DataType::Float, dims.clone(), bytes));
        let value = Value { name: name.into(), shape: dims.into_iter().map(Length::Known).collect() };
        self.used.insert(name.to_owned(), value.clone());
        value
    }

    pub(crate) fn constant(&mut self, numbers: &[f32], shape: &[i64]) -> Value {
        assert_eq!(numbers.len() as i64, shape.iter().product::<i64>(), "numbers of a constant {shape:?}");
        let bytes = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
        let name = self.stored(DataType::Float, shape.to_vec(), bytes);
        Value { name, shape: shape.iter().map(|length| Length::Known(*length)).collect() }
    }

    pub(crate) fn scalar(&mut self, number: f32) -> Value {
        self.constant(&[number], &[])
    }

    fn integers(&mut self, integers: &[i64]) -> Rc<str> {
        let bytes = integers.iter().flat_map(|integer| integer.to_le_bytes()).collect();
        self.stored(DataType::Int64, vec![integers.len() as i64], bytes)
    }

    fn stored(&mut self, kind: DataType, dims: Vec<i64>, bytes: Vec<u8>) -> Rc<str> {
        let key = (kind, dims, bytes);
        if let Some(name) = self.constants.get(&key) {
            return name.clone();
        }
        let name: Rc<str> = format!("constant_{}", self.constants.len()).into();
        self.initializers.push(tensor(&name, kind, key.1.clone(), key.2.clone()));
        self.constants.insert(key, name.clone());
        name
    }

    /// A node with one output, whose name is returned; `label` is a part of it.
    fn node(
        &mut self,
        operator: &'static str,
        label: &str,
        inputs: &[&str],
        attributes: &[(&str, Attribute)],
    ) -> Rc<str> {
        let number = self.nodes.len();
        let name = match self.scope.as_str() {
            "" => format!("{label}_{number}"),
            scope => format!("{scope}/{label}_{number}"),
        };
        self.push(operator, &name, inputs, name.clone(), attributes);
        name.into()
    }

    fn push(
        &mut self,
        operator: &'static str,
        name: &str,
        inputs: &[&str],
        output: String,
        attributes: &[(&str, Attribute)],
    ) {
        self.nodes.push(NodeProto {
            input: inputs.iter().map(|input| (*input).to_owned()).collect(),
            output: vec![output],
            name: Some(name.to_owned()),
            op_type: Some(operator.to_owned()),
            attribute: attributes.iter().map(|(name, value)| attribute(name, value)).collect(),
        });
    }

    /// What `operator` makes of tensors, which has this shape.
    pub(crate) fn apply(
        &mut self,
        operator: &'static str,
        inputs: &[&Value],
        attributes: &[(&str, Attribute)],
        shape: Vec<Length>,
    ) -> Value {
        self.apply_labelled(operator, operator, inputs, attributes, shape)
    }

    /// [`apply`](Self::apply) with another name for the node than its operator's.
    pub(crate) fn apply_labelled(
        &mut self,
        operator: &'static str,
        label: &str,
        inputs: &[&Value],
        attributes: &[(&str, Attribute)],
        shape: Vec<Length>,
    ) -> Value {
        let inputs: Vec<&str> = inputs.iter().map(|input| &*input.name).collect();
        Value { name: self.node(operator, label, &inputs, attributes), shape }
    }

    /// An operator on each number, such as `Relu`.
    pub(crate) fn each(&mut self, operator: &'static str, x: &Value) -> Value {
        self.apply(operator, &[x], &[], x.shape())
    }

    /// An operator on pairs of numbers, such as `Add`. Axes of length 1 are repeated.
    pub(crate) fn pairs(&mut self, operator: &'static str, a: &Value, b: &Value) -> Value {
        let shape = broadcast(&a.shape, &b.shape);
        self.apply(operator, &[a, b], &[], shape)
    }

    pub(crate) fn add(&mut self, a: &Value, b: &Value) -> Value {
        self.pairs("Add", a, b)
    }

    pub(crate) fn subtract(&mut self, a: &Value, b: &Value) -> Value {
        self.pairs("Sub", a, b)
    }

    pub(crate) fn multiply(&mut self, a: &Value, b: &Value) -> Value {
        self.pairs("Mul", a, b)
    }

    pub(crate) fn divide(&mut self, a: &Value, b: &Value) -> Value {
        self.pairs("Div", a, b)
    }

    pub(crate) fn scale(&mut self, x: &Value, factor: f32) -> Value {
        let factor = self.scalar(factor);
        self.multiply(x, &factor)
    }

    pub(crate) fn shift(&mut self, x: &Value, by: f32) -> Value {
        let by = self.scalar(by);
        self.add(x, &by)
    }

    /// `[m, k]` times `[k, n]`.
    pub(crate) fn product(&mut self, a: &Value, b: &Value) -> Value {
        assert_eq!(a.length(1), b.length(0), "the inner length of a product of matrices");
        let shape = vec![a.length(0), b.length(1)];
        self.apply("MatMul", &[a, b], &[], shape)
    }

    pub(crate) fn softmax(&mut self, x: &Value, axis: i64) -> Value {
        self.apply("Softmax", &[x], &[("axis", Attribute::Int(axis))], x.shape())
    }

    pub(crate) fn concat(&mut self, parts: &[&Value], axis: usize) -> Value {
        let mut shape = parts[0].shape();
        shape[axis] = Length::Known(parts.iter().map(|part| part.known(axis)).sum());
        self.apply("Concat", parts, &[("axis", Attribute::Int(axis as i64))], shape)
    }

    pub(crate) fn transpose(&mut self, x: &Value, order: &[i64]) -> Value {
        let shape = order.iter().map(|axis| x.length(*axis as usize)).collect();
        self.apply("Transpose", &[x], &[("perm", Attribute::Ints(order.to_vec()))], shape)
    }

    pub(crate) fn reshape(&mut self, x: &Value, shape: Vec<Length>) -> Value {
        let open = shape.iter().filter(|length| matches!(length, Length::Computed(..))).count();
        let list = if open == 1 {
            // It follows from the others.
            let inferred = shape.iter().map(|length| match length {
                Length::Known(length) => *length,
                Length::Computed(..) => -1,
            });
            self.integers(&inferred.collect::<Vec<i64>>())
        } else {
            self.list(&shape)
        };
        let name = self.node("Reshape", "Reshape", &[&x.name, &list], &[]);
        Value { name, shape }
    }

    /// Channels `from` to `from + count` of a map.
    pub(crate) fn channels(&mut self, x: &Value, from: i64, count: i64) -> Value {
        assert!(from + count <= x.known(1), "{count} channels from {from} on, of {}", x.known(1));
        self.narrow(x, 1, &Length::Known(from), &Length::Known(count))
    }

    /// `length` entries of an axis.
    pub(crate) fn narrow(&mut self, x: &Value, axis: usize, from: &Length, length: &Length) -> Value {
        if *from == Length::Known(0) && *length == x.shape[axis] {
            return x.clone();
        }
        let end = self.plus(from, length);
        let lists = [from, &end].map(|length| self.list(std::slice::from_ref(length)));
        let axes = self.integers(&[axis as i64]);
        let name = self.node("Slice", "Slice", &[&x.name, &lists[0], &lists[1], &axes], &[]);
        let mut shape = x.shape();
        shape[axis] = length.clone();
        Value { name, shape }
    }

    /// A map `[batch, channels, height, width]` with its outermost rows and columns repeated, which makes it this height and width.
    pub(crate) fn extended(&mut self, x: &Value, sides: &Sides, size: [Length; 2]) -> Value {
        if *sides == Sides::all(0) {
            return x.clone();
        }
        let Sides { top, left, bottom, right } = sides;
        let none = || Length::Known(0);
        let list = [none(), none(), top.clone(), left.clone(), none(), none(), bottom.clone(), right.clone()];
        let list = self.list(&list);
        let name = self.node("Pad", "Pad", &[&x.name, &list], &[("mode", Attribute::Text("edge"))]);
        let [height, width] = size;
        Value { name, shape: vec![x.length(0), x.length(1), height, width] }
    }

    pub(crate) fn zeros(&mut self, shape: Vec<Length>) -> Value {
        let list = self.list(&shape);
        Value { name: self.node("ConstantOfShape", "Zeros", &[&list], &[]), shape }
    }

    /// The sum over an axis, which goes away.
    pub(crate) fn sum(&mut self, x: &Value, axis: usize) -> Value {
        let axes = self.integers(&[axis as i64]);
        let keep = [("keepdims", Attribute::Int(0))];
        let name = self.node("ReduceSum", "ReduceSum", &[&x.name, &axes], &keep);
        let mut shape = x.shape();
        shape.remove(axis);
        Value { name, shape }
    }

    /// Lengths as numbers: `[lengths]`.
    pub(crate) fn numbers(&mut self, lengths: &[Length]) -> Value {
        let count = lengths.len() as i64;
        if lengths.iter().all(|length| matches!(length, Length::Known(_))) {
            let numbers: Vec<f32> = lengths.iter().map(|length| length.known() as f32).collect();
            return self.constant(&numbers, &[count]);
        }
        let list = self.list(lengths);
        let name = self.floats(&list);
        Value { name, shape: vec![Length::Known(count)] }
    }

    /// The numbers 0, 1, 2 and so on: `[length]`.
    pub(crate) fn count(&mut self, length: &Length) -> Value {
        if let Length::Known(length) = length {
            let numbers: Vec<f32> = (0..*length).map(|number| number as f32).collect();
            return self.constant(&numbers, &[*length]);
        }
        let name = self.list(std::slice::from_ref(length));
        let [first, step] = [0_i64, 1]
            .map(|integer| self.stored(DataType::Int64, Vec::new(), integer.to_le_bytes().to_vec()));
        let axes = self.integers(&[0]);
        let end = self.node("Squeeze", "Squeeze", &[&name, &axes], &[]);
        let range = self.node("Range", "Range", &[&first, &end, &step], &[]);
        Value { name: self.floats(&range), shape: vec![length.clone()] }
    }

    fn floats(&mut self, integers: &str) -> Rc<str> {
        self.node("Cast", "Cast", &[integers], &[("to", Attribute::Int(DataType::Float as i64))])
    }

    /// An int64 tensor `[lengths]`.
    fn list(&mut self, lengths: &[Length]) -> Rc<str> {
        if let Some(name) = self.lists.get(lengths) {
            return name.clone();
        }
        let mut parts: Vec<Rc<str>> = Vec::new();
        let mut known = Vec::new();
        for length in lengths {
            match length {
                Length::Known(length) => known.push(*length),
                Length::Computed(times, name) => {
                    if !known.is_empty() {
                        parts.push(self.integers(&std::mem::take(&mut known)));
                    }
                    parts.push(self.computed(*times, name));
                }
            }
        }
        if !known.is_empty() {
            parts.push(self.integers(&known));
        }
        let name = match parts.as_slice() {
            [one] => one.clone(),
            parts => {
                let parts: Vec<&str> = parts.iter().map(|part| &**part).collect();
                self.node("Concat", "Lengths", &parts, &[("axis", Attribute::Int(0))])
            }
        };
        self.lists.insert(lengths.to_vec(), name.clone());
        name
    }

    /// The tensor of so many times a length.
    fn computed(&mut self, times: i64, name: &Rc<str>) -> Rc<str> {
        if times == 1 {
            return name.clone();
        }
        let key = ("Mul", Length::Known(times), Length::Computed(1, name.clone()));
        if let Some(name) = self.lengths.get(&key) {
            return name.clone();
        }
        let factor = self.integers(&[times]);
        let product = self.node("Mul", "Length", &[&factor, name], &[]);
        self.lengths.insert(key, product.clone());
        product
    }

    pub(crate) fn plus(&mut self, a: &Length, b: &Length) -> Length {
        match (a, b) {
            (length, Length::Known(0)) | (Length::Known(0), length) => length.clone(),
            _ => self.combined("Add", a, b, |a, b| a + b),
        }
    }

    pub(crate) fn minus(&mut self, a: &Length, b: &Length) -> Length {
        self.combined("Sub", a, b, |a, b| a - b)
    }

    pub(crate) fn times(&mut self, a: &Length, b: &Length) -> Length {
        match (a, b) {
            (Length::Known(factor), Length::Computed(times, name))
            | (Length::Computed(times, name), Length::Known(factor)) => {
                Length::Computed(factor * times, name.clone())
            }
            _ => self.combined("Mul", a, b, |a, b| a * b),
        }
    }

    /// Rounded down.
    pub(crate) fn over(&mut self, a: &Length, b: i64) -> Length {
        match a {
            Length::Computed(times, name) if times % b == 0 => Length::Computed(times / b, name.clone()),
            _ => self.combined("Div", a, &Length::Known(b), |a, b| a / b),
        }
    }

    pub(crate) fn at_least(&mut self, a: &Length, b: i64) -> Length {
        self.combined("Max", a, &Length::Known(b), i64::max)
    }

    /// The smallest multiple of `of` that is not below `a`.
    pub(crate) fn next_multiple(&mut self, a: &Length, of: i64) -> Length {
        let more = self.plus(a, &Length::Known(of - 1));
        let whole = self.over(&more, of);
        self.times(&whole, &Length::Known(of))
    }

    fn combined(
        &mut self,
        operator: &'static str,
        a: &Length,
        b: &Length,
        of_known: fn(i64, i64) -> i64,
    ) -> Length {
        if let (Length::Known(a), Length::Known(b)) = (a, b) {
            return Length::Known(of_known(*a, *b));
        }
        let key = (operator, a.clone(), b.clone());
        if let Some(name) = self.lengths.get(&key) {
            return Length::Computed(1, name.clone());
        }
        let [left, right] = [a, b].map(|length| self.list(std::slice::from_ref(length)));
        let name = self.node(operator, "Length", &[&left, &right], &[]);
        self.lengths.insert(key, name.clone());
        Length::Computed(1, name)
    }
}

fn broadcast(a: &[Length], b: &[Length]) -> Vec<Length> {
    let axes = a.len().max(b.len());
    let length = |shape: &[Length], axis: usize| {
        (axis + shape.len()).checked_sub(axes).map_or(Length::Known(1), |axis| shape[axis].clone())
    };
    let common = |axis| match (length(a, axis), length(b, axis)) {
        (Length::Known(1), other) | (other, Length::Known(1)) => other,
        (of_a, of_b) => {
            assert_eq!(of_a, of_b, "lengths of {a:?} and {b:?}");
            of_a
        }
    };
    (0..axes).map(common).collect()
}

fn tensor(name: &str, kind: DataType, dims: Vec<i64>, bytes: Vec<u8>) -> TensorProto {
    TensorProto { dims, data_type: Some(kind as i32), name: Some(name.to_owned()), raw_data: Some(bytes) }
}

fn attribute(name: &str, value: &Attribute) -> AttributeProto {
    let of = |kind: AttributeType| AttributeProto {
        name: Some(name.to_owned()),
        r#type: Some(kind as i32),
        ..AttributeProto::default()
    };
    match value {
        Attribute::Int(i) => AttributeProto { i: Some(*i), ..of(AttributeType::Int) },
        Attribute::Float(f) => AttributeProto { f: Some(*f), ..of(AttributeType::Float) },
        Attribute::Ints(ints) => AttributeProto { ints: ints.clone(), ..of(AttributeType::Ints) },
        Attribute::Text(s) => AttributeProto { s: Some(s.as_bytes().to_vec()), ..of(AttributeType::String) },
    }
}

/// An input or output of floats.
fn described(
    name: &str,
    description: &str,
    dimensions: impl Iterator<Item = Option<DimensionValue>>,
) -> ValueInfoProto {
    let shape = TensorShapeProto { dim: dimensions.map(|value| DimensionProto { value }).collect() };
    let kind = TensorTypeProto { elem_type: Some(DataType::Float as i32), shape: Some(shape) };
    ValueInfoProto {
        name: Some(name.to_owned()),
        r#type: Some(TypeProto { tensor_type: Some(kind) }),
        doc_string: Some(description.to_owned()),
    }
}
