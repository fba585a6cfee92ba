-- Results by what decided their bits.

alter table tessera.jobs
    -- Of the result, as in status; null unless it is kept.
    add column fingerprint bytea check (octet_length(fingerprint) = 32);
create index jobs_same on tessera.jobs (tenant, fingerprint, id) where state = 2;
