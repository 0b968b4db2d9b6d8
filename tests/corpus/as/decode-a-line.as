; A list of numbers from a PC: one $DECODE for the field, one for the separators.
; after: fields = 4
; after: v[1] = 1234
; after: v[2] = 93465.2 +- 0.01
; after: v[3] = 0.4358 +- 0.0000001
; after: v[4] = 3458103
; after: $rest = ""
.PROGRAM main()
  $rest="1234,93465.2,,.4358,3458103"
  fields=0
  WHILE LEN($rest)>0 DO
    $field=$DECODE($rest,",",0)
    fields=fields+1
    v[fields]=VAL($field)
    $gone=$DECODE($rest,",",1)
  END
.END
