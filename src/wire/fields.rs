//! Options by their names and as text, as a query has them.
//!
//! Purpose: [`Fields`] takes the options of a remesh one by one and gives the message; [`all`] lists them for documents. Both
//! are read from the schema, so that an option of the message needs nothing here. [`schema`] says the
//! same of a field of any message.
//! Invariant: an option has the name of its field; those of the density lie beside the others, and its source is `density`.
//! An enum's value is its last word in lower case. Must not know: what an option does, which values make sense together.

use prost::Name;
use prost_reflect::{DynamicMessage, FieldDescriptor, Kind, Value};
use serde_json::json;

use super::json::{comment, descriptor, to_value};
use super::options::of_remesh;
use super::proto::RemeshOptions;
use geometry::remesh::RemeshOptions as Options;

/// The message within the options whose fields have names of their own.
const DENSITY: &str = "density";
/// Its field that has the message's name.
const SOURCE: &str = "source";

/// Between the texts of a list that is one text.
pub const BETWEEN: char = ';';

#[derive(Clone, Debug)]
pub struct Field {
    /// The name that the command, HTTP and Python share.
    pub name: String,
    /// What the schema says of it, one paragraph.
    pub help: String,
    descriptor: FieldDescriptor,
    in_density: bool,
}

/// All options of a remesh, in the order of the schema.
pub fn all() -> Vec<Field> {
    let fields = descriptor::<RemeshOptions>().into_iter().flat_map(|message| message.fields().collect::<Vec<_>>());
    let mut all = Vec::new();
    for field in fields {
        match field.kind() {
            Kind::Message(inner) => all.extend(inner.fields().map(|field| Field::of(field, true))),
            _ => all.push(Field::of(field, false)),
        }
    }
    all
}

impl Field {
    fn of(descriptor: FieldDescriptor, in_density: bool) -> Self {
        let name = if in_density && descriptor.name() == SOURCE { DENSITY } else { descriptor.name() };
        let help = comment(&descriptor);
        Self { name: name.to_owned(), help, descriptor, in_density }
    }

    /// The words of an enum, except the unspecified value.
    fn words(&self) -> Vec<String> {
        words(&self.descriptor)
    }

    /// Its type as a schema of JSON, with the library's default.
    pub fn schema(&self) -> serde_json::Value {
        let mut schema = type_of(&self.descriptor);
        // Points are no option's default: the caller says them.
        let usual = to_value(&of_remesh(&Options::usual()));
        let usual = if self.in_density { &usual[DENSITY] } else { &usual };
        match &usual[self.descriptor.name()] {
            _ if self.descriptor.kind() == Kind::Bool => schema["default"] = false.into(),
            serde_json::Value::String(word) => {
                let word = word.to_ascii_lowercase();
                schema["default"] = self.words().into_iter().find(|short| word.ends_with(short.as_str())).into();
            }
            number @ serde_json::Value::Number(_) if self.name != "points" => schema["default"] = number.clone(),
            _ => {}
        }
        schema
    }

    /// A text as its type; else what it must be.
    fn read(&self, text: &str) -> Result<Value, String> {
        if self.descriptor.is_list() {
            let all = text.split(BETWEEN).map(str::trim).filter(|one| !one.is_empty());
            return Ok(Value::List(all.map(|one| Value::String(one.to_owned())).collect()));
        }
        let kind = self.descriptor.kind();
        let whole = |most| whole(text).filter(|number| *number <= most);
        let read = match &kind {
            Kind::Uint32 => whole(u32::MAX.into()).map(|number| Value::U32(number as u32)),
            Kind::Uint64 => whole(u64::MAX).map(Value::U64),
            Kind::Enum(values) => {
                let text = text.replace('-', "_");
                let place = self.words().iter().position(|word| *word == text);
                place.and_then(|place| Some(Value::EnumNumber(values.values().nth(place + 1)?.number())))
            }
            Kind::Bool => text.parse().ok().map(Value::Bool),
            // What it says is read with the message.
            Kind::String => Some(Value::String(text.to_owned())),
            _ => text.parse::<f64>().ok().filter(|number| number.is_finite()).map(Value::F64),
        };
        read.ok_or_else(|| match kind {
            Kind::Uint32 | Kind::Uint64 => "a whole number, as 10000, 1e4, 10k or 10,000, and not too large".to_owned(),
            Kind::Enum(_) => {
                let words = self.words();
                let (last, others) = words.split_last().map_or(("", &[][..]), |(last, others)| (last.as_str(), others));
                format!("{} or {last}", others.join(", "))
            }
            Kind::Bool => "true or false".to_owned(),
            _ if self.name == "anisotropy" => "a number or auto".to_owned(),
            _ if self.name == "weld" => "a length, or percent of the diagonal as 0.01%".to_owned(),
            _ => "a number".to_owned(),
        })
    }
}

/// The words of an enum, except the unspecified value; none for other types.
fn words(field: &FieldDescriptor) -> Vec<String> {
    let Kind::Enum(values) = field.kind() else { return Vec::new() };
    let all: Vec<_> = values.values().map(|value| value.name().to_owned()).collect();
    let prefix = all.first().map_or(0, |none| none.len() - "UNSPECIFIED".len());
    all.iter().skip(1).map(|name| name[prefix..].to_ascii_lowercase()).collect()
}

/// The type and the comment of a field. A duration is a number of seconds.
fn type_of(field: &FieldDescriptor) -> serde_json::Value {
    let mut schema = match field.kind() {
        Kind::Enum(_) => json!({ "type": "string", "enum": words(field) }),
        Kind::Uint32 | Kind::Uint64 => json!({ "type": "integer", "minimum": 0 }),
        Kind::Int32 => json!({ "type": "integer" }),
        Kind::Bool => json!({ "type": "boolean" }),
        Kind::String => json!({ "type": "string" }),
        _ => json!({ "type": "number" }),
    };
    schema["description"] = comment(field).into();
    schema
}

/// The type of a field as a schema of JSON, with its comment; null if the message has no such field.
pub fn schema<M: Name>(name: &str) -> serde_json::Value {
    let field = descriptor::<M>().and_then(|message| message.get_field_by_name(name));
    field.as_ref().map(type_of).unwrap_or_default()
}

#[derive(Debug)]
pub struct Fields {
    all: Vec<Field>,
    message: Option<DynamicMessage>,
}

impl Default for Fields {
    fn default() -> Self {
        Self { all: all(), message: descriptor::<RemeshOptions>().map(DynamicMessage::new) }
    }
}

impl Fields {
    /// Takes an option. Whether there is one of this name.
    pub fn set(&mut self, name: &str, text: &str) -> Result<bool, String> {
        let (name, text) = match (name, text.trim(), text.trim().strip_suffix('%')) {
            // A number of points may be a share of the vertices.
            ("points", _, Some(percent)) => ("points_percent", percent),
            ("weld", _, Some(percent)) => ("weld_percent", percent),
            ("anisotropy", "auto", _) => ("anisotropy_auto", "true"),
            _ => (name, text),
        };
        let Some(field) = self.all.iter().find(|field| field.name == name) else { return Ok(false) };
        let value = field.read(text)?;
        let mut message = self.message.as_mut();
        if field.in_density {
            message = message.and_then(|all| all.get_field_by_name_mut(DENSITY)?.as_message_mut());
        }
        message.into_iter().for_each(|message| message.set_field(&field.descriptor, value.clone()));
        Ok(true)
    }

    /// The message.
    pub fn finish(self) -> RemeshOptions {
        self.message.and_then(|message| message.transcode_to().ok()).unwrap_or_default()
    }
}

/// A whole number as people write it: `10000`, `1e4`, `10k`, `10,000`, `1.5m`.
pub fn whole(text: &str) -> Option<u64> {
    /// Up to here every whole number is one of double precision.
    const EXACT: f64 = (1u64 << 53) as f64;
    let text = text.trim();
    let (text, unit) = match text.strip_suffix(['k', 'K', 'm', 'M']) {
        Some(rest) => (rest, if text.ends_with(['k', 'K']) { 1e3 } else { 1e6 }),
        None => (text, 1.0),
    };
    let mut groups = text.split(',');
    let first = groups.next().filter(|first| !first.is_empty())?;
    let digits = |group: &str, most: usize| group.len() <= most && group.bytes().all(|b| b.is_ascii_digit());
    let text = match text.contains(',') {
        true if digits(first, 3) && groups.clone().all(|group| group.len() == 3 && digits(group, 3)) => {
            text.replace(',', "")
        }
        true => return None,
        false => text.replace('_', ""),
    };
    let exact = || text.parse::<u64>().ok().filter(|_| unit == 1.0);
    let real = || text.parse::<f64>().ok().map(|x| x * unit).filter(|x| (0.0..=EXACT).contains(x) && x.fract() == 0.0);
    exact().or_else(|| real().map(|x| x as u64))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::proto::{DensitySource, Projection};

    #[test]
    fn every_option_is_set_by_its_name() {
        let mut fields = Fields::default();
        for (name, text) in
            [("points", "1e4"), ("seed", "7"), ("density", "lfs"), ("gradation", "0.5"), ("projection", "surface")]
        {
            assert_eq!(fields.set(name, text), Ok(true), "{name}");
        }
        for (text, number) in [("10k", 10_000), ("10,000", 10_000), ("1_000", 1_000), ("1.5m", 1_500_000), (" 7 ", 7)] {
            assert_eq!(whole(text), Some(number), "{text}");
        }
        for text in ["1,5", "1,5k", ",000", "1.0005k", "k", "", "-1", "10,00", "1e4k,000", "inf", "nan", "1,0000"] {
            assert_eq!(whole(text), None, "{text}");
        }
        assert_eq!(fields.set("point", "1"), Ok(false));
        assert_eq!(fields.set("keep", "steel; box:0,0,0,1,1,1;"), Ok(true));
        assert_eq!(fields.set("mirror", "-x=0.5"), Ok(true));
        assert_eq!(fields.set("periodic", "translate:1,0,0;rotate:-60,z"), Ok(true));
        for (name, text) in
            [("points", "1.5"), ("density", "blue"), ("gradation", "nan"), ("lloyd", "5e9"), ("thin", "")]
        {
            fields.set(name, text).unwrap_err();
        }
        let options = fields.finish();
        let density = options.density.clone().unwrap();
        assert_eq!(options.keep, ["steel", "box:0,0,0,1,1,1"]);
        assert_eq!(options.mirror.as_deref(), Some("-x=0.5"));
        assert_eq!(options.periodic, ["translate:1,0,0", "rotate:-60,z"]);
        assert_eq!((options.points, options.seed, options.projection()), (Some(10_000), Some(7), Projection::Surface));
        assert_eq!((density.source(), density.gradation, options.lloyd), (DensitySource::Lfs, Some(0.5), None));
        assert_eq!(Fields::default().finish(), RemeshOptions::default());
    }

    #[test]
    fn the_schema_says_what_an_option_is() {
        let all = all();
        let of = |name: &str| all.iter().find(|field| field.name == name).unwrap().schema();
        assert_eq!(of("lloyd")["default"], 5);
        assert_eq!(of("projection")["default"], "free");
        assert_eq!(of("projection")["enum"], json!(["free", "surface"]));
        assert_eq!((&of("mirror")["type"], of("mirror").get("default")), (&json!("string"), None));
        assert_eq!((of("points").get("default"), of("max_deviation").get("default")), (None, None));
        assert!(all.iter().all(|field| field.help.ends_with('.')), "{all:?}");
    }
}
