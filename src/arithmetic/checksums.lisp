;;; anmech: a checksum of texts, the CRC-32 of ISO 3309, which gzip and zip use, too.
;;;
;;; It finds what has been cut short or damaged by accident; it keeps nobody from forging.
;;;
;;; Entry points: EXTENDED-CHECKSUM, CHECKSUM-TEXT.

(in-package :anmech)

(defun checksum-of-byte (byte)
  (loop repeat 8
        do (setq byte (if (logbitp 0 byte) (logxor #xedb88320 (ash byte -1)) (ash byte -1)))
        finally (return byte)))

(defvar *checksums-of-bytes*
  (coerce (loop for byte below 256 collect (checksum-of-byte byte)) 'simple-vector))

(defun extended-checksum (text &optional (before 0))
  "The checksum of the texts that BEFORE is one of, followed by TEXT, whose characters are bytes."
  (declare (type string text))
  (let ((table *checksums-of-bytes*) (rest (logxor before #xffffffff)))
    (declare (simple-vector table) (fixnum rest))
    (loop for char across text
          do (setq rest (logxor (the fixnum (svref table (logand 255 (logxor rest (char-code char)))))
                                (the fixnum (ash rest -8)))))
    (logxor rest #xffffffff)))

(defun checksum-text (checksum)
  (format nil "~(~8,'0x~)" checksum))
