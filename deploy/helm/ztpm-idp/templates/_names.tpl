{{- define "ztpm-idp.name" -}}
{{- printf "%s-ztpm-idp" .Release.Name | trunc 52 | trimSuffix "-" -}}
{{- end -}}

{{- define "ztpm-idp.labels" -}}
app.kubernetes.io/name: ztpm-idp
app.kubernetes.io/instance: {{ .Release.Name }}
{{- end -}}

{{- define "ztpm-idp.path" -}}
{{- get (urlParse .Values.issuer) "path" -}}
{{- end -}}

{{- define "ztpm-idp.image" -}}
{{- printf "%s:%s" .Values.image.repository (.Values.image.tag | default .Chart.AppVersion) -}}
{{- end -}}

{{- define "ztpm-idp.container" -}}
image: {{ include "ztpm-idp.image" . | quote }}
imagePullPolicy: {{ .Values.image.pullPolicy | default "IfNotPresent" }}
securityContext:
  allowPrivilegeEscalation: false
  readOnlyRootFilesystem: true
  capabilities: {drop: [ALL]}
env:
  - {name: ZTPM_PASSPHRASE_FILE, value: /run/secrets/ztpm/passphrase}
  - {name: ZTPM_DATA, value: /var/lib/ztpm/provider}
  {{- if .Values.metrics.tokenSecret }}
  - {name: ZTPM_METRICS_TOKEN_FILE, value: /run/secrets/metrics/token}
  {{- end }}
volumeMounts:
  - {name: provider, mountPath: /var/lib/ztpm}
  - {name: passphrase, mountPath: /run/secrets/ztpm, readOnly: true}
  - {name: tls, mountPath: /run/tls, readOnly: true}
  {{- if .Values.metrics.tokenSecret }}
  - {name: metrics, mountPath: /run/secrets/metrics, readOnly: true}
  {{- end }}
  - {name: tmp, mountPath: /tmp}
{{- end -}}
