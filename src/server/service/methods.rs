//! The methods that are served, by name.
//!
//! Invariant: the list comes from the descriptors, so that a new method is on it. Must not know: what methods do.

use prost::Message as _;
use prost_types::FileDescriptorSet;

use wire::proto;

/// What tonic's reflection serves, whose descriptors are its own.
const REFLECTION: [&str; 2] = [
    "grpc.reflection.v1.ServerReflection/ServerReflectionInfo",
    "grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo",
];

/// All of them, as "package.Service/Method".
pub(super) fn all() -> Vec<String> {
    let mut all: Vec<String> = REFLECTION.map(str::to_owned).to_vec();
    for bytes in [proto::DESCRIPTORS, tonic_health::pb::FILE_DESCRIPTOR_SET] {
        for file in FileDescriptorSet::decode(bytes).unwrap_or_default().file {
            for service in &file.service {
                let of = |method: &prost_types::MethodDescriptorProto| {
                    format!("{}.{}/{}", file.package(), service.name(), method.name())
                };
                all.extend(service.method.iter().map(of));
            }
        }
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn methods_of_all_services_are_there() {
        let all = all();
        for method in [
            "tessera.v1.RemeshService/Remesh",
            "tessera.v1.JobService/CreateJob",
            "tessera.v1.BlobService/Write",
            "tessera.v1.ServerService/GetServerInfo",
            "grpc.health.v1.Health/Watch",
        ] {
            assert!(all.iter().any(|name| name == method), "{method}");
        }
    }
}
