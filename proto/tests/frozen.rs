//! Compares the interface with its frozen form. Fields, methods and values may be added, but existing ones
//! may neither change nor disappear. Until the first release an issue may replace the frozen form. After an
//! addition, run `SIGHTLINE_FREEZE=1 cargo test --workspace --test frozen`.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::collections::BTreeSet;
use std::path::Path;

use prost::Message as _;
use prost_types::{DescriptorProto, EnumDescriptorProto, FileDescriptorSet};

/// Returns the parts of the interface that must not change: one line for each field, value and method.
fn lines(set: &FileDescriptorSet) -> BTreeSet<String> {
    let mut all = BTreeSet::new();
    for file in set
        .file
        .iter()
        .filter(|file| file.package() == "sightline.v1")
    {
        file.message_type
            .iter()
            .for_each(|message| of_message(".sightline.v1", message, &mut all));
        file.enum_type
            .iter()
            .for_each(|e| of_enum(".sightline.v1", e, &mut all));
        for service in &file.service {
            for method in &service.method {
                let stream = |is: bool| if is { "stream " } else { "" };
                all.insert(format!(
                    "rpc {}.{}({}{}) returns ({}{})",
                    service.name(),
                    method.name(),
                    stream(method.client_streaming()),
                    method.input_type(),
                    stream(method.server_streaming()),
                    method.output_type()
                ));
            }
        }
    }
    all
}

fn of_message(within: &str, message: &DescriptorProto, all: &mut BTreeSet<String>) {
    let name = format!("{within}.{}", message.name());
    for field in &message.field {
        let oneof = field
            .oneof_index
            .and_then(|i| message.oneof_decl.get(i as usize));
        let oneof = oneof.map_or_else(String::new, |oneof| format!(" in {}", oneof.name()));
        let kind = if field.type_name().is_empty() {
            format!("{:?}", field.r#type()).to_lowercase()
        } else {
            field.type_name().to_owned()
        };
        let label = format!("{:?}", field.label()).to_lowercase();
        all.insert(format!(
            "field {name} {} {label} {kind} {}{oneof}",
            field.number(),
            field.name()
        ));
    }
    message
        .nested_type
        .iter()
        .for_each(|nested| of_message(&name, nested, all));
    message
        .enum_type
        .iter()
        .for_each(|e| of_enum(&name, e, all));
}

fn of_enum(within: &str, of: &EnumDescriptorProto, all: &mut BTreeSet<String>) {
    for value in &of.value {
        all.insert(format!(
            "value {within}.{} {} {}",
            of.name(),
            value.number(),
            value.name()
        ));
    }
}

#[test]
fn interface_keeps_frozen_form() {
    let now = lines(&FileDescriptorSet::decode(sightline_proto::DESCRIPTORS).unwrap());
    assert!(
        now.contains("field .sightline.v1.ShowRequest 1 optional uint64 job"),
        "{now:?}"
    );
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("frozen/v1.txt");
    if std::env::var_os("SIGHTLINE_FREEZE").is_some() {
        let text: String = now.iter().map(|line| format!("{line}\n")).collect();
        std::fs::write(&path, text).unwrap();
    }
    let frozen = std::fs::read_to_string(&path).unwrap();
    let frozen: BTreeSet<String> = frozen.lines().map(str::to_owned).collect();
    let changed: Vec<&String> = frozen.difference(&now).collect();
    assert!(
        changed.is_empty(),
        "clients rely on these, which have changed or are gone: {changed:#?}"
    );
    let unfrozen: Vec<&String> = now.difference(&frozen).collect();
    assert!(
        unfrozen.is_empty(),
        "freeze what is new (see the top of this file): {unfrozen:#?}"
    );
}
