#!/usr/bin/env bash
# Makes a keystore of SROS2 by openssl, laid out as `ros2 security create_keystore` does, or adds enclaves to one.
usage="usage: keystore.sh DIR [--days N] [--listen /ENCLAVE]... [/ENCLAVE]...
  DIR       the keystore; what is there stays, what is missing is made
  /ENCLAVE  a participant that may publish and hear everything; default /patchmill, which is the enclave of every patchmill process
  --listen  a participant that hears everything, asks for products, and tells and starts nothing; its node is named as the enclave ends
  --days    for how long the certificates of what is made now hold; default 3650
Whoever has DIR/private can let anybody in: keep it elsewhere, and give each host only its enclaves and DIR/public."
set -euo pipefail
umask 077 # private keys are nobody else's

fail() { echo "keystore.sh: $*" >&2; exit 2; }

directory='' days=3650 enclaves=() listeners=()
while [ $# -gt 0 ]; do
  case $1 in
    --help | -h) echo "$usage"; exit 0 ;;
    --days | --listen) [ $# -ge 2 ] || fail "$1 needs a value" ;;&
    --days) days=$2; shift 2 ;;
    --listen) listeners+=("$2"); shift 2 ;;
    -*) fail "unknown argument '$1'"$'\n'"$usage" ;;
    *) if [ -z "$directory" ]; then directory=$1; else enclaves+=("$1"); fi; shift ;;
  esac
done
[ -n "$directory" ] || fail "the keystore's folder is missing"$'\n'"$usage"
[[ $days =~ ^[1-9][0-9]{0,4}$ ]] || fail "--days is '$days': expected a whole number of days"
command -v openssl >/dev/null || fail "openssl is missing: install the package openssl"
[ ${#enclaves[@]} -gt 0 ] || [ ${#listeners[@]} -gt 0 ] || enclaves=(/patchmill)
for name in "${enclaves[@]}" "${listeners[@]}"; do
  [[ $name =~ ^(/[A-Za-z_][A-Za-z0-9_]*)+$ ]] || fail "enclave '$name': expected an absolute name such as /patchmill"
done
public=$directory/public private=$directory/private

# An elliptic key on P-256, as DDS Security 9.3.1 asks, in PKCS#8.
key() { openssl genpkey -quiet -algorithm EC -pkeyopt ec_paramgen_curve:P-256 -out "$1"; }

# XML on stdin, signed by the authority of permissions.
sign() { openssl smime -sign -text -in "$1" -out "$2" -signer "$public/permissions_ca.cert.pem" -inkey "$private/permissions_ca.key.pem"; }

authority() {
  key "$private/ca.key.pem"
  openssl req -x509 -new -key "$private/ca.key.pem" -subj /CN=patchmillCA -days "$days" -sha256 -out "$public/ca.cert.pem"
  for role in identity_ca permissions_ca; do
    ln -sf ca.cert.pem "$public/$role.cert.pem"
    ln -sf ca.key.pem "$private/$role.key.pem"
  done
}

# As sros2 has it: everything encrypted, nobody in without a certificate and rights. Any domain: `patchmill plan` takes a free one.
governance() {
  cat >"$1" <<'XML'
<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" xsi:noNamespaceSchemaLocation="http://www.omg.org/spec/DDS-SECURITY/20170901/omg_shared_ca_governance.xsd">
  <domain_access_rules>
    <domain_rule>
      <domains><id_range><min>0</min><max>232</max></id_range></domains>
      <allow_unauthenticated_participants>false</allow_unauthenticated_participants>
      <enable_join_access_control>true</enable_join_access_control>
      <discovery_protection_kind>ENCRYPT</discovery_protection_kind>
      <liveliness_protection_kind>ENCRYPT</liveliness_protection_kind>
      <rtps_protection_kind>ENCRYPT</rtps_protection_kind>
      <topic_access_rules>
        <topic_rule>
          <topic_expression>*</topic_expression>
          <enable_discovery_protection>true</enable_discovery_protection>
          <enable_liveliness_protection>true</enable_liveliness_protection>
          <enable_read_access_control>true</enable_read_access_control>
          <enable_write_access_control>true</enable_write_access_control>
          <metadata_protection_kind>ENCRYPT</metadata_protection_kind>
          <data_protection_kind>ENCRYPT</data_protection_kind>
        </topic_rule>
      </topic_access_rules>
    </domain_rule>
  </domain_access_rules>
</dds>
XML
}

# What an enclave may: NAME, topics that it publishes, topics that it hears (patterns; rt topics, rq requests, rr replies).
# From yesterday on, for hosts whose clocks differ.
permissions() {
  cat <<XML
<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" xsi:noNamespaceSchemaLocation="http://www.omg.org/spec/DDS-SECURITY/20170901/omg_shared_ca_permissions.xsd">
  <permissions>
    <grant name="$1">
      <subject_name>CN=$1</subject_name>
      <validity>
        <not_before>$(date -u -d yesterday +%Y-%m-%dT%H:%M:%SZ)</not_before>
        <not_after>$(date -u -d "+$days days" +%Y-%m-%dT%H:%M:%SZ)</not_after>
      </validity>
      <allow_rule>
        <domains><id_range><min>0</min><max>232</max></id_range></domains>
        <publish><topics>$(printf '<topic>%s</topic>' $2)</topics></publish>
        <subscribe><topics>$(printf '<topic>%s</topic>' $3)</topics></subscribe>
      </allow_rule>
      <default>DENY</default>
    </grant>
  </permissions>
</dds>
XML
}

# A certificate for the key of an enclave: NAME, FOLDER. openssl also says on stderr what went well.
certify() {
  message=$({
    openssl req -new -key "$2/key.pem" -subj "/CN=${1//\//\\/}" |
      openssl x509 -req -sha256 -days "$days" -CA "$public/identity_ca.cert.pem" -CAkey "$private/identity_ca.key.pem" \
        -set_serial "0x$(openssl rand -hex 16)" -extfile <(echo basicConstraints=CA:FALSE) -out "$2/cert.pem"
  } 2>&1)
}

# An enclave: NAME, and what it publishes and hears as above.
enclave() {
  local folder=$directory/enclaves/${1#/} up
  mkdir -p "$folder"
  up=$(realpath --relative-to="$folder" "$directory")
  ln -sfn "$up/public/identity_ca.cert.pem" "$folder/identity_ca.cert.pem"
  ln -sfn "$up/public/permissions_ca.cert.pem" "$folder/permissions_ca.cert.pem"
  ln -sfn "$up/enclaves/governance.p7s" "$folder/governance.p7s"
  if [ ! -f "$folder/key.pem" ] || [ ! -f "$folder/cert.pem" ]; then
    key "$folder/key.pem"
    certify "$1" "$folder" || fail "enclave $1: its certificate cannot be made: $message"
  fi
  permissions "$@" >"$folder/permissions.xml"
  sign "$folder/permissions.xml" "$folder/permissions.p7s"
  echo "$folder"
}

set -f # topic patterns are not file names
mkdir -p "$public" "$private" "$directory/enclaves"
[ -f "$private/permissions_ca.key.pem" ] && [ -f "$private/identity_ca.key.pem" ] || authority
if [ ! -f "$directory/enclaves/governance.p7s" ]; then
  governance "$directory/enclaves/governance.xml"
  sign "$directory/enclaves/governance.xml" "$directory/enclaves/governance.p7s"
fi
for name in "${enclaves[@]}"; do
  enclave "$name" '*' '*'
done
for name in "${listeners[@]}"; do
  node=${name##*/}
  enclave "$name" "ros_discovery_info rt/rosout rt/parameter_events rr/*/$node/*Reply rr/$node/*Reply rq/*/get_*Request" \
    "ros_discovery_info rt/* rq/*/$node/*Request rq/$node/*Request rr/*/get_*Reply"
done
