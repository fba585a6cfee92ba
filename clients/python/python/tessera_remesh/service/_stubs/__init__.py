"""Messages of the service, made from proto/ by tools/make_stubs.sh."""
