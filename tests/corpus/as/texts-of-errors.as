; Every code has a text, also those that this controller's own programs never meet.
; after: $e[1] = "Not a program instruction"
; after: $e[2] = "Structures overlap"
; after: $e[3] = "Program does not exist"
; after: $e[4] = "No array suffix"
; after: $e[5] = "Floating point overflow"
; after: $e[6] = "Receiving data is too long (MAX=255 characters)"
; after: $e[7] = "Socket open failure"
; after: $e[8] = "Socket close failure"
; after: $e[9] = "Communication error"
; after: $e[10] = "No buffer space"
; after: $e[11] = "Bad socket"
; after: $e[12] = "Ethernet board is not installed"
.PROGRAM main()
  $e[1]=$ERRORS("P0113")
  $e[2]=$ERRORS("P0147")
  $e[3]=$ERRORS("P0151")
  $e[4]=$ERRORS("E0107")
  $e[5]=$ERRORS("E0109")
  $e[6]=$ERRORS("E4007")
  $e[7]=$ERRORS("E4019")
  $e[8]=$ERRORS("E4020")
  $e[9]=$ERRORS("E4021")
  $e[10]=$ERRORS("E4026")
  $e[11]=$ERRORS("E4027")
  $e[12]=$ERRORS("E4054")
.END
