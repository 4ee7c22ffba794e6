//! A job as JSON: the message with the names of its fields, plain numbers, and the names of enum values.

use prost::Message as _;
use prost_reflect::{DescriptorPool, DynamicMessage, Kind, ReflectMessage as _, Value};
use serde_json::Value as Json;

use super::JobSpec;

impl JobSpec {
    /// Returns the message as JSON, including defaults.
    ///
    /// Digests are in hexadecimal. Viewpoints are replaced by their digest and boxes by their number, because
    /// both may be large. The choice of a backend is omitted: a result depends on the used profile, which the
    /// result's info names.
    pub fn to_json(&self) -> Json {
        let mut json = json_of(&self.to_message().encode_to_vec()).unwrap_or(Json::Null);
        remove_field(&mut json, "backend");
        if let Some(boxes) = find_field_mut(&mut json, "boxes").and_then(Json::as_object_mut) {
            let axes = boxes.remove("axes");
            boxes.remove("planes");
            let is_box = |axis: &&Json| axis.as_u64() == Some(3);
            let axes = axes.as_ref().and_then(Json::as_array);
            let count = axes.map_or(0, |axes| axes.iter().filter(is_box).count());
            boxes.insert("count".to_owned(), count.into());
        }
        json
    }
}

fn remove_field(json: &mut Json, name: &str) {
    if let Some(fields) = json.as_object_mut() {
        fields.remove(name);
        fields
            .values_mut()
            .for_each(|value| remove_field(value, name));
    }
}

fn find_field_mut<'a>(json: &'a mut Json, name: &str) -> Option<&'a mut Json> {
    let fields = json.as_object_mut()?;
    if fields.contains_key(name) {
        return fields.get_mut(name);
    }
    fields
        .values_mut()
        .find_map(|value| find_field_mut(value, name))
}

/// Finds a field of a job's JSON by its name, at any depth, because results of other programs may have any
/// parameters. Two fields of different meaning never have the same name.
pub fn find_field<'a>(json: &'a Json, name: &str) -> Option<&'a Json> {
    let fields = json.as_object()?;
    let inner = || fields.values().find_map(|value| find_field(value, name));
    fields.get(name).or_else(inner)
}

/// Converts an encoded job message to JSON. Returns `None` if the bytes are not such a message.
fn json_of(bytes: &[u8]) -> Option<Json> {
    let pool = DescriptorPool::decode(sightline_proto::DESCRIPTORS).ok()?;
    let descriptor = pool.get_message_by_name("sightline.v1.JobSpec")?;
    let message = DynamicMessage::decode(descriptor, bytes).ok()?;
    Some(object(&message))
}

fn object(message: &DynamicMessage) -> Json {
    let descriptor = message.descriptor();
    let given = descriptor.fields().filter(|field| message.has_field(field));
    let named = given.map(|field| {
        let value = value(&message.get_field(&field), &field.kind());
        (field.name().to_owned(), value)
    });
    Json::Object(named.collect())
}

fn value(value_of: &Value, kind: &Kind) -> Json {
    match value_of {
        Value::Bool(flag) => (*flag).into(),
        Value::I32(number) => (*number).into(),
        Value::I64(number) => (*number).into(),
        Value::U32(number) => (*number).into(),
        Value::U64(number) => (*number).into(),
        Value::F32(number) => (*number).into(),
        Value::F64(number) => (*number).into(),
        Value::String(text) => text.as_str().into(),
        Value::Bytes(bytes) => digest(bytes).into(),
        Value::EnumNumber(number) => enum_name(*number, kind),
        Value::Message(message) => object(message),
        Value::List(values) => values.iter().map(|one| value(one, kind)).collect(),
        // A job has no maps.
        Value::Map(_) => Json::Null,
    }
}

/// Returns 32 bytes in hexadecimal. Returns the BLAKE3 digest of `bytes` in hexadecimal for other lengths.
fn digest(bytes: &[u8]) -> String {
    let digest = bytes.try_into().map(blake3::Hash::from_bytes);
    digest
        .unwrap_or_else(|_| blake3::hash(bytes))
        .to_hex()
        .to_string()
}

/// Returns the name of an enum's value without the name of the enum, in lower case, or the number if the
/// value has no name.
fn enum_name(number: i32, kind: &Kind) -> Json {
    let Kind::Enum(of) = kind else {
        return number.into();
    };
    let Some(value) = of.get_value(number) else {
        return number.into();
    };
    // `ERROR_MEASURE_SETS` of `ErrorMeasure` is `sets`.
    let mut prefix = String::new();
    for letter in of.name().chars() {
        if letter.is_ascii_uppercase() && !prefix.is_empty() {
            prefix.push('_');
        }
        prefix.push(letter.to_ascii_uppercase());
    }
    let name = value.name();
    let bare = name
        .strip_prefix(&prefix)
        .and_then(|rest| rest.strip_prefix('_'));
    bare.unwrap_or(name)
        .to_ascii_lowercase()
        .replace('_', "-")
        .into()
}
