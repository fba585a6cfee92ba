//! Which role each method needs: the one table.
//!
//! Invariant: every method of `proto/` is here, and none besides; a test compares the two. A method that is not here is not
//! served. Must not know: keys.

use prost::Message as _;
use prost_types::FileDescriptorSet;

use crate::keys::Role;
use wire::proto;

/// What a call needs where keys are required.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Needs {
    /// A key with this role, or more.
    Role(Role),
    /// Nothing, unless it is said otherwise.
    Health,
    /// Any key.
    Reflection,
}

const METHODS: &[(&str, &str, Role)] = &[
    ("tessera.v1.RemeshService", "ComputeRvd", Role::Submit),
    ("tessera.v1.RemeshService", "Cvt", Role::Submit),
    ("tessera.v1.RemeshService", "Remesh", Role::Submit),
    ("tessera.v1.BlobService", "Write", Role::Submit),
    ("tessera.v1.BlobService", "QueryWriteStatus", Role::Read),
    ("tessera.v1.BlobService", "Read", Role::Read),
    ("tessera.v1.BlobService", "FindMissing", Role::Read),
    ("tessera.v1.BlobService", "Stat", Role::Read),
    ("tessera.v1.BlobService", "Delete", Role::Submit),
    ("tessera.v1.JobService", "CreateJob", Role::Submit),
    ("tessera.v1.JobService", "GetJob", Role::Read),
    ("tessera.v1.JobService", "ListJobs", Role::Read),
    ("tessera.v1.JobService", "WatchJob", Role::Read),
    ("tessera.v1.JobService", "CancelJob", Role::Submit),
    ("tessera.v1.JobService", "DeleteJob", Role::Submit),
    ("tessera.v1.JobService", "EstimateJob", Role::Read),
    ("tessera.v1.ServerService", "GetServerInfo", Role::Read),
];

const HEALTH: &str = "grpc.health.v1.Health";
const REFLECTION: [&str; 2] = ["grpc.reflection.v1.ServerReflection", "grpc.reflection.v1alpha.ServerReflection"];

/// What the method at this path needs; nothing if there is no such method.
pub(super) fn needs(path: &str) -> Option<Needs> {
    let (service, method) = path.strip_prefix('/')?.split_once('/')?;
    if service == HEALTH {
        return Some(Needs::Health);
    }
    if REFLECTION.contains(&service) {
        return Some(Needs::Reflection);
    }
    let found = METHODS.iter().find(|(its_service, its_method, _)| (*its_service, *its_method) == (service, method));
    found.map(|(_, _, role)| Needs::Role(*role))
}

/// All methods that are served, as "package.Service/Method": from the descriptors, so that a new method is on the list.
pub(in crate::service) fn served() -> Vec<String> {
    let mut all: Vec<String> = REFLECTION.map(|name| format!("{name}/ServerReflectionInfo")).to_vec();
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
    use std::collections::BTreeSet;

    use prost::Message as _;

    use super::*;

    #[test]
    fn every_method_has_a_role() {
        let files = FileDescriptorSet::decode(proto::DESCRIPTORS).unwrap().file;
        let described: BTreeSet<(String, String)> = files
            .iter()
            .filter(|file| file.package().starts_with("tessera."))
            .flat_map(|file| file.service.iter().map(move |service| (file.package(), service)))
            .flat_map(|(package, service)| {
                let name = format!("{package}.{}", service.name());
                service.method.iter().map(move |method| (name.clone(), method.name().to_owned()))
            })
            .collect();
        let written: BTreeSet<_> = METHODS.iter().map(|(s, m, _)| ((*s).to_owned(), (*m).to_owned())).collect();
        assert_eq!(written, described, "give each method of proto/ a role in METHODS");
        assert_eq!(written.len(), METHODS.len(), "once");
    }

    #[test]
    fn what_only_asks_needs_no_more_than_read() {
        for (_, method, role) in METHODS {
            let asks = ["Get", "List", "Watch", "Stat", "Read", "Find", "Query", "Estimate"];
            assert_eq!(asks.iter().any(|begin| method.starts_with(begin)), *role == Role::Read, "{method}");
        }
        assert_eq!(needs("/grpc.health.v1.Health/Check"), Some(Needs::Health));
        assert_eq!(needs("/grpc.reflection.v1.ServerReflection/ServerReflectionInfo"), Some(Needs::Reflection));
        for path in [
            "",
            "/",
            "tessera.v1.JobService/GetJob",
            "/tessera.v1.JobService/getjob",
            "/tessera.v1.JobService/GetJob/",
            "//",
        ] {
            assert_eq!(needs(path), None, "{path}");
        }
    }

    #[test]
    fn methods_of_all_services_are_there() {
        let all = served();
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
